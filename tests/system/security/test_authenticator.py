"""Authentication and connection budgets on real sockets; the authenticator is polled by hand."""

import socket as plain
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
import zmq

from protocol import sockets
from protocol.refusals import TOO_MANY
from protocol.security.allow_list import UNREADABLE_AT_MOST_NS, revoke
from protocol.security.authenticator import Authenticator
from protocol.security.connection_table import (
    BEHIND_NS,
    MAX_EVENTS,
    ConnectionBudget,
    ConnectionTable,
)
from protocol.security.link_keys import ClientKeys, ServerKeys
from protocol.sockets import Context, Socket
from tests.support.keyring import Keyring
from tests.support.waiting import PATIENCE_S

QUIET_S = 0.3
MOST = 40
HERE, THERE = "127.0.0.1", "127.0.0.2"


def has_ipv6() -> bool:
    """Return whether this machine has IPv6; containers often have none."""
    try:
        with plain.socket(plain.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return False
    return True


needs_ipv6 = pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
ADDRESSES = [
    "tcp://127.0.0.1:*",
    pytest.param("tcp://[::1]:*", marks=needs_ipv6),
    pytest.param("tcp://[::]:*", marks=needs_ipv6),
    "ipc",
]
linux = pytest.mark.skipif(sys.platform != "linux", reason="needs 127.0.0.2 and filters")


class Subscriber:
    """A SUB socket and the numbers it has received."""

    def __init__(self, socket: Socket) -> None:
        self.socket = socket
        self.received: list[int] = []

    def receive(self) -> None:
        self.received += [int(message) for message in sockets.receive_parts(self.socket)]


class Publisher:
    """A bound PUB socket with an authenticator that sends consecutive numbers to subscribers."""

    def __init__(
        self, context: Context, keys: ServerKeys | None, address: str, most: int | None = None
    ) -> None:
        self._context = context
        self._subscribers: list[Subscriber] = []
        self._strangers = ExitStack()
        self.authenticator = Authenticator(context, keys, most)
        self.rejected = self.authenticator.rejected
        self.data = sockets.bind(context, zmq.PUB, address, self.authenticator)
        self.address = self.data.getsockopt_string(zmq.LAST_ENDPOINT)
        self.sent = 0

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2])

    def subscribe(self, keys: ClientKeys | None, source: str = "") -> Subscriber:
        socket = sockets.unconnected(self._context, zmq.SUB, keys)
        socket.setsockopt(zmq.IPV6, "[" in self.address)
        socket.subscribe(b"")
        # Where both are bound, IPv4 is used.
        address = self.address.replace("[::]", HERE).replace("0.0.0.0", HERE)
        socket.connect(address.replace("tcp://", f"tcp://{source}:0;" if source else "tcp://"))
        self._subscribers.append(Subscriber(socket))
        return self._subscribers[-1]

    def connect_stranger(self, source: str = HERE) -> plain.socket:
        one = plain.create_connection((HERE, self.port), timeout=5, source_address=(source, 0))
        return self._strangers.enter_context(one)

    def poll_until(self, done: Callable[[], object]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.rejected
            self.authenticator.poll(time.perf_counter_ns())
            sockets.send(self.data, b"%d" % self.sent)
            self.sent += 1
            for subscriber in self._subscribers:
                subscriber.receive()
            time.sleep(0.002)

    def poll_for(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        self.poll_until(lambda: time.monotonic() > end_s)

    def close(self) -> None:
        self._strangers.close()


@pytest.fixture
def publisher(
    request: pytest.FixtureRequest, context: Context, keyring: Keyring
) -> Iterator[Publisher]:
    address = getattr(request, "param", "tcp://127.0.0.1:*")
    if address == "ipc":
        if not zmq.has("ipc"):
            pytest.skip("no ipc here")
        address = f"ipc://{keyring.folder}/data"
    try:
        yield Publisher(context, keyring.server(), address)
    except OSError:
        pytest.skip(f"{address} cannot be bound here")


@pytest.fixture
def small(context: Context) -> Iterator[Publisher]:
    """Yield a publisher without keys that may have few connections."""
    publisher = Publisher(context, None, "tcp://*:*", most=MOST)
    yield publisher
    publisher.close()


@pytest.mark.parametrize("publisher", ADDRESSES, indirect=True)
@pytest.mark.parametrize(
    ("cause", "keys_of"),
    [
        ("unknown_key", lambda ring: ring.client("stranger")),
        ("no_key", lambda ring: None),
        ("not_authentic", lambda ring: ring.client("finger", peer="stranger")),
    ],
)
def test_a_peer_that_is_not_allowed_receives_nothing_and_is_counted(
    publisher: Publisher,
    keyring: Keyring,
    cause: str,
    keys_of: Callable[[Keyring], ClientKeys | None],
    logged: list[str],
) -> None:
    subscriber = publisher.subscribe(keys_of(keyring))
    publisher.poll_until(lambda: publisher.rejected[cause])
    publisher.poll_for(QUIET_S)
    assert subscriber.received == []
    # A peer without the right keys detects it as soon as the node does, and may hang up first.
    counted = {cause} if cause == "unknown_key" else {cause, "handshake"}
    assert set(publisher.rejected) <= counted
    # Once; or a second time, with its address, where it left before its address was read.
    assert 1 <= len(logged) <= (1 if cause == "unknown_key" else 2 * len(publisher.rejected))
    assert all(line.startswith("refused ") for line in logged)
    if cause == "unknown_key":
        ipc = publisher.address.startswith("ipc")
        host = "a peer:" if ipc else publisher.address.split("/")[2]
        assert host.rpartition(":")[0].strip("[]") in logged[0]
        assert keyring.pair("stranger").public.key.hex() in logged[0]


@pytest.mark.parametrize("publisher", ADDRESSES, indirect=True)
def test_allowed_keys_receive_until_revoked_and_the_others_continue(
    publisher: Publisher, keyring: Keyring, logged: list[str]
) -> None:
    keyring.allow("thumb")
    stays, goes = (publisher.subscribe(keyring.client(name)) for name in ("finger", "thumb"))
    publisher.poll_until(lambda: stays.received and goes.received)
    assert (publisher.rejected, logged) == ({}, [])
    revoke(keyring.allowed, "thumb")
    publisher.poll_until(lambda: publisher.rejected["revoked_key"] >= 1)
    before, back = len(goes.received), publisher.sent
    publisher.poll_until(lambda: stays.received[-1] > back)
    publisher.poll_for(QUIET_S)
    assert len(goes.received) == before
    # Both lines name the peer and the beginning of its key.
    thumb = f"thumb (key {keyring.pair('thumb').public.key.hex()[:16]}...) is no longer allowed"
    assert logged[0] == thumb
    refused = [line for line in logged[1:] if line.startswith("refused ") and thumb in line]
    assert len(refused) == 1
    # A cut may hit a connection that is being made again.
    assert set(publisher.rejected) <= {"revoked_key", "handshake"}


@linux
def test_only_connections_from_addresses_of_the_revoked_key_are_cut(
    publisher: Publisher, keyring: Keyring
) -> None:
    keyring.allow("thumb")
    near = publisher.subscribe(keyring.client("finger"))
    far = publisher.subscribe(keyring.client("thumb"), source=THERE)
    publisher.poll_until(lambda: near.received and far.received)
    revoke(keyring.allowed, "thumb")
    publisher.poll_until(lambda: publisher.rejected["revoked_key"] >= 1)
    end = publisher.sent
    publisher.poll_until(lambda: near.received[-1] > end)
    assert near.received == list(range(near.received[0], near.received[-1] + 1))
    assert far.received[-1] < end


def test_a_key_that_is_allowed_during_the_run_connects(
    publisher: Publisher, keyring: Keyring
) -> None:
    early = publisher.subscribe(keyring.client("thumb"))
    publisher.poll_until(lambda: publisher.rejected["unknown_key"] == 1)
    keyring.allow("thumb")
    # A refused peer does not connect again by itself; a display does.
    publisher.poll_for(1.2)
    sockets.reconnect(early.socket, publisher.address, publisher.address)
    publisher.poll_until(lambda: early.received)


def test_all_but_the_node_itself_are_cut_while_the_list_cannot_be_read(
    publisher: Publisher, keyring: Keyring, logged: list[str]
) -> None:
    other, own = (publisher.subscribe(keyring.client(name)) for name in ("finger", "wrist"))
    publisher.poll_until(lambda: other.received and own.received)
    keyring.allowed.write_text("nonsense\n", encoding="utf-8")
    publisher.poll_until(lambda: logged)
    # This stands for 10 s of waiting.
    publisher.authenticator.poll(time.perf_counter_ns() + UNREADABLE_AT_MOST_NS)
    publisher.poll_until(lambda: publisher.rejected["list_unreadable"])
    before, back = len(other.received), publisher.sent
    publisher.poll_until(lambda: own.received[-1] > back)
    assert len(other.received) == before


def test_no_peer_connects_without_an_answer_of_the_authenticator(
    publisher: Publisher, keyring: Keyring
) -> None:
    publisher.authenticator.own_sockets[0].close(0)
    subscriber = publisher.subscribe(keyring.client("finger"))
    end_s = time.monotonic() + QUIET_S
    while time.monotonic() < end_s:
        sockets.send(publisher.data, b"0")
        time.sleep(0.002)
    assert not subscriber.socket.poll(0)


def test_a_flood_while_the_authenticator_is_not_polled_blocks_no_connection(
    publisher: Publisher, keyring: Keyring, logged: list[str]
) -> None:
    """An unread monitor with a high-water mark would block ZeroMQ's thread and all connections."""
    subscriber = publisher.subscribe(keyring.client("finger"))
    publisher.poll_until(lambda: subscriber.received)
    for _ in range(1500):
        with plain.create_connection((HERE, publisher.port)) as one:
            one.send(b"GET / HTTP/1.1\r\n\r\n")
    subscriber.receive()
    sockets.send(publisher.data, b"-1")
    assert subscriber.socket.poll(PATIENCE_S * 1000)
    assert subscriber.socket.recv() == b"-1"
    # The first of them may be those of the allowed client, which has the same address.
    publisher.poll_until(lambda: publisher.rejected["handshake"] >= 1400)
    assert len(logged) <= 2


@linux
def test_an_allowed_client_that_connects_again_is_not_counted_as_refused(
    publisher: Publisher, keyring: Keyring, logged: list[str]
) -> None:
    def break_off(source: str) -> None:
        for how in ("closed", "reset"):
            one = publisher.connect_stranger(source)
            # Its address is read.
            publisher.poll_for(QUIET_S / 3)
            if how == "reset":
                one.setsockopt(plain.SOL_SOCKET, plain.SO_LINGER, struct.pack("ii", 1, 0))
            one.close()
            publisher.poll_for(QUIET_S / 3)

    subscriber = publisher.subscribe(keyring.client("finger"))
    publisher.poll_until(lambda: subscriber.received)
    for _ in range(3):
        break_off(HERE)
    assert (publisher.rejected, logged) == ({}, [])
    # Another address is a stranger's.
    break_off(THERE)
    publisher.poll_until(lambda: publisher.rejected["handshake"] == 2)
    revoke(keyring.allowed, "finger")
    publisher.poll_until(lambda: publisher.rejected["revoked_key"])
    break_off(HERE)
    publisher.poll_until(lambda: publisher.rejected["handshake"] >= 4)


def is_closed(one: plain.socket) -> bool:
    one.setblocking(False)
    try:
        # ZeroMQ greets each connection; then nothing follows, or the end.
        while one.recv(100):
            pass
    except BlockingIOError:
        return False
    except ConnectionError:
        pass
    return True


@linux
def test_the_oldest_silent_connections_are_cut_and_block_no_other_peer(
    context: Context, small: Publisher, logged: list[str]
) -> None:
    """Neither a peer of another address nor one of the same address at another socket."""
    early = small.subscribe(None, source=THERE)
    small.poll_until(lambda: early.received)
    strangers = [small.connect_stranger() for _ in range(2 * MOST)]
    cut = 2 * MOST - MOST // 2
    small.poll_until(lambda: small.rejected[TOO_MANY] == cut)
    small.poll_until(lambda: sum(map(is_closed, strangers)) == cut)
    assert [is_closed(one) for one in strangers] == [True] * cut + [False] * (MOST // 2)
    assert len(logged) == 1
    assert logged[0].startswith(f"refused {HERE}: more connections than")
    late, back = small.subscribe(None, source=THERE), small.sent
    small.poll_until(lambda: late.received and early.received[-1] > back)
    other = sockets.bind(context, zmq.XPUB, f"tcp://{HERE}:*", small.authenticator)
    small.address = other.getsockopt_string(zmq.LAST_ENDPOINT)
    near = small.subscribe(None, source=HERE)
    small.poll_until(lambda: sockets.has_message(other))
    assert small.rejected.keys() == {TOO_MANY}
    assert not near.received


@linux
def test_one_address_does_not_take_all_connections(small: Publisher) -> None:
    first = small.subscribe(None, source=THERE)
    many = [small.subscribe(None, source=HERE) for _ in range(MOST)]
    small.poll_until(lambda: small.rejected[TOO_MANY] >= MOST - MOST * 3 // 4)
    late, back = small.subscribe(None, source=THERE), small.sent
    small.poll_until(lambda: late.received and first.received[-1] > back)
    for one in many:
        one.socket.close(0)


@linux
def test_a_call_reads_a_bounded_number_of_events_and_pauses_a_socket_that_is_behind(
    context: Context,
) -> None:
    bound = sockets.unconnected(context, zmq.PUB)
    table, budget = ConnectionTable(context, bound), ConnectionBudget(MOST)
    port = bound.bind_to_random_port(f"tcp://{HERE}")
    for _ in range(5 * MAX_EVENTS):
        plain.create_connection((HERE, port)).close()

    def poll_until(behind: bool) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while table.behind is not behind:
            assert time.monotonic() < end_s
            table.failures()
            budget.enforce([table], time.perf_counter_ns())

    poll_until(behind=True)
    assert table.connections <= MAX_EVENTS
    budget.enforce([table], time.perf_counter_ns() + BEHIND_NS)
    late = plain.socket()
    late.settimeout(0.1)
    with late, pytest.raises(TimeoutError):
        late.connect((HERE, port))
    poll_until(behind=False)
    plain.create_connection((HERE, port), timeout=PATIENCE_S).close()
