"""Admission on real sockets; the gate is polled by hand."""

import socket as plain
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zmq

from protocol import sockets
from protocol.errors import KeyFileError
from protocol.security import authenticator as gate_module
from protocol.security.allow_list import UNREADABLE_AT_MOST_NS, revoke
from protocol.security.authenticator import Authenticator
from protocol.security.keys import ClientKeys
from protocol.sockets import Context, Socket
from tests.support.keyring import Keyring

PATIENCE_S = 20.0
QUIET_S = 0.3


class Listener:
    """A SUB socket and the numbers it has heard."""

    def __init__(self, socket: Socket) -> None:
        self.socket = socket
        self.heard: list[int] = []

    def listen(self) -> None:
        while self.socket.poll(0):
            self.heard.append(int(self.socket.recv()))


class Hall:
    """A guarded PUB socket that says a number whenever it is looked after, and its listeners."""

    def __init__(self, context: Context, keyring: Keyring, address: str) -> None:
        self._context = context
        self._listeners: list[Listener] = []
        self.gate = Authenticator(context, keyring.server())
        self.data = sockets.bind(context, zmq.PUB, address, self.gate)
        self.address = self.data.getsockopt_string(zmq.LAST_ENDPOINT)
        self.sent = 0

    def listener(self, keys: ClientKeys | None, whence: str = "") -> Listener:
        socket = sockets.unconnected(self._context, zmq.SUB, keys)
        socket.setsockopt(zmq.IPV6, "[" in self.address)
        socket.subscribe(b"")
        # Over IPv4, too, to where both are listened to.
        address = self.address.replace("[::]", "127.0.0.1")
        socket.connect(address.replace("tcp://", f"tcp://{whence}"))
        self._listeners.append(Listener(socket))
        return self._listeners[-1]

    def tend(self) -> None:
        self.gate.poll(time.monotonic_ns())
        sockets.send(self.data, b"%d" % self.sent)
        self.sent += 1
        for listener in self._listeners:
            listener.listen()
        time.sleep(0.002)

    def tend_until(self, done: Callable[[], object]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.gate.rejected
            self.tend()

    def tend_for(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        self.tend_until(lambda: time.monotonic() > end_s)


@pytest.fixture
def keyring(tmp_path: Path) -> Keyring:
    keyring = Keyring(tmp_path / "keys")
    keyring.allow("finger")
    return keyring


@pytest.fixture(params=["tcp://127.0.0.1:*", "tcp://[::1]:*", "tcp://[::]:*", "ipc"])
def hall(request: pytest.FixtureRequest, context: Context, keyring: Keyring) -> Iterator[Hall]:
    address = request.param
    if address == "ipc":
        if not zmq.has("ipc"):
            pytest.skip("no ipc here")
        address = f"ipc://{keyring.folder}/hall"
    try:
        yield Hall(context, keyring, address)
    except OSError:
        pytest.skip(f"{address} cannot be bound here")


def test_who_is_allowed_hears_it(hall: Hall, keyring: Keyring, logged: list[str]) -> None:
    listener = hall.listener(keyring.client("finger"))
    hall.tend_until(lambda: listener.heard)
    assert hall.gate.rejected == {}
    assert logged == []


@pytest.mark.parametrize(
    ("cause", "who"),
    [
        ("unknown_key", lambda ring: ring.client("stranger")),
        ("no_key", lambda ring: None),
        ("not_authentic", lambda ring: ring.client("finger", peer="stranger")),
    ],
)
def test_who_is_not_allowed_hears_nothing_and_is_counted(
    hall: Hall,
    keyring: Keyring,
    cause: str,
    who: Callable[[Keyring], ClientKeys | None],
    logged: list[str],
) -> None:
    listener = hall.listener(who(keyring))
    hall.tend_until(lambda: hall.gate.rejected[cause])
    hall.tend_for(QUIET_S)
    assert listener.heard == []
    # Who has not the right keys knows as soon as the node does, and now and then hangs up first.
    counted = {cause} if cause == "unknown_key" else {cause, "handshake"}
    assert set(hall.gate.rejected) <= counted
    # Once; or a second time, with its address, where it had left before that was asked for.
    assert 1 <= len(logged) <= (1 if cause == "unknown_key" else 2 * len(hall.gate.rejected))
    assert all(line.startswith("refused ") for line in logged)
    if cause == "unknown_key":
        host = "a peer:" if hall.address.startswith("ipc") else hall.address.split("/")[2]
        assert host.rpartition(":")[0].strip("[]") in logged[0]
        assert keyring.pair("stranger").public.key.hex() in logged[0]


def test_a_hundred_attempts_are_counted_each_and_logged_once(
    context: Context, keyring: Keyring, logged: list[str]
) -> None:
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    stranger = hall.listener(keyring.client("stranger"))
    for attempt in range(1, 101):
        hall.tend_until(lambda attempt=attempt: hall.gate.rejected["unknown_key"] == attempt)
        if attempt < 100:
            sockets.reconnect(stranger.socket, hall.address, hall.address)
    assert hall.gate.rejected["unknown_key"] == 100
    # It may leave before it has its answer, too.
    assert len([line for line in logged if line.endswith(" is not allowed")]) == 1
    assert len(logged) <= 2


def test_who_is_revoked_is_cut_off_and_who_is_not_goes_on(
    hall: Hall, keyring: Keyring, logged: list[str]
) -> None:
    keyring.allow("thumb")
    stays, goes = (hall.listener(keyring.client(name)) for name in ("finger", "thumb"))
    hall.tend_until(lambda: stays.heard and goes.heard)
    revoke(keyring.allowed, "thumb")
    hall.tend_until(lambda: hall.gate.rejected["revoked_key"] >= 1)
    told, back = len(goes.heard), hall.sent
    hall.tend_until(lambda: stays.heard[-1] > back)
    hall.tend_for(QUIET_S)
    assert len(goes.heard) == told
    assert logged[0] == "thumb is allowed no more"
    assert len([line for line in logged if line.endswith(" is allowed no more")]) == 2
    # A cut may meet one that just connects anew.
    assert set(hall.gate.rejected) <= {"revoked_key", "handshake"}


def test_only_connections_from_where_the_revoked_key_was_seen_are_cut(
    context: Context, keyring: Keyring
) -> None:
    if not _can_bind("127.0.0.2"):
        pytest.skip("127.0.0.2 is not this machine's here")
    keyring.allow("thumb")
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    near = hall.listener(keyring.client("finger"))
    far = hall.listener(keyring.client("thumb"), whence="127.0.0.2:0;")
    hall.tend_until(lambda: near.heard and far.heard)
    revoke(keyring.allowed, "thumb")
    hall.tend_until(lambda: hall.gate.rejected["revoked_key"] >= 1)
    end = hall.sent
    hall.tend_until(lambda: near.heard[-1] > end)
    assert near.heard == list(range(near.heard[0], near.heard[-1] + 1))
    assert far.heard[-1] < end


def test_who_is_allowed_while_it_runs_gets_in(context: Context, keyring: Keyring) -> None:
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    early = hall.listener(keyring.client("thumb"))
    hall.tend_until(lambda: hall.gate.rejected["unknown_key"] == 1)
    keyring.allow("thumb")
    # One that was refused does not knock again by itself; a display connects anew.
    hall.tend_for(1.2)
    sockets.reconnect(early.socket, hall.address, hall.address)
    hall.tend_until(lambda: early.heard)


def test_a_revocation_in_a_list_that_could_not_be_read_at_first_counts_once_it_can(
    context: Context, keyring: Keyring, logged: list[str]
) -> None:
    keyring.allow("thumb")
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    goes = hall.listener(keyring.client("thumb"))
    hall.tend_until(lambda: goes.heard)
    keyring.allowed.write_text(keyring.pair("finger").public.line + "\n")
    keyring.allowed.chmod(0o664)
    hall.tend_until(lambda: any("chmod go-w" in line for line in logged))
    late = hall.listener(keyring.client("finger"))
    hall.tend_until(lambda: hall.gate.rejected["list_unreadable"])
    keyring.allowed.chmod(0o644)
    hall.tend_until(lambda: hall.gate.rejected["revoked_key"])
    assert "thumb is allowed no more" in logged
    assert late.heard == []


def test_nobody_stays_while_the_list_cannot_be_read(
    context: Context, keyring: Keyring, logged: list[str]
) -> None:
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    listener = hall.listener(keyring.client("finger"))
    own = hall.listener(keyring.client("wrist"))
    hall.tend_until(lambda: listener.heard and own.heard)
    keyring.allowed.write_text("nonsense\n")
    hall.tend_until(lambda: logged)
    # In place of 10 s of waiting.
    hall.gate.poll(time.monotonic_ns() + UNREADABLE_AT_MOST_NS)
    hall.tend_until(lambda: hall.gate.rejected["list_unreadable"])
    heard, back = len(listener.heard), hall.sent
    hall.tend_until(lambda: own.heard[-1] > back)
    assert len(listener.heard) == heard


def test_a_list_that_is_taken_away_allows_nobody(context: Context, keyring: Keyring) -> None:
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    listener = hall.listener(keyring.client("finger"))
    hall.tend_until(lambda: listener.heard)
    keyring.allowed.unlink()
    hall.tend_until(lambda: hall.gate.rejected["revoked_key"] >= 1)


def test_a_list_that_is_unusable_at_the_start_is_an_error(
    context: Context, keyring: Keyring
) -> None:
    keyring.allowed.write_text("nonsense\n")
    with pytest.raises(KeyFileError):
        Authenticator(context, keyring.server())


def test_without_a_gate_that_answers_nobody_gets_in(context: Context, keyring: Keyring) -> None:
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    hall.gate.sockets[0].close(0)
    listener = hall.listener(keyring.client("finger"))
    end_s = time.monotonic() + QUIET_S
    while time.monotonic() < end_s:
        sockets.send(hall.data, b"0")
        time.sleep(0.002)
    assert not listener.socket.poll(0)


def test_a_flood_that_nobody_looks_after_holds_up_no_connection(
    context: Context, keyring: Keyring, logged: list[str]
) -> None:
    """ZeroMQ's thread would wait for a monitor that is not read, and with it all connections."""
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    listener = hall.listener(keyring.client("finger"))
    hall.tend_until(lambda: listener.heard)
    port = int(hall.address.rpartition(":")[2])
    for _ in range(1500):
        with plain.create_connection(("127.0.0.1", port)) as one:
            one.send(b"GET / HTTP/1.1\r\n\r\n")
    listener.listen()
    sockets.send(hall.data, b"-1")
    assert listener.socket.poll(PATIENCE_S * 1000)
    assert listener.socket.recv() == b"-1"
    hall.tend_until(lambda: hall.gate.rejected["handshake"] == 1500)
    assert len(logged) <= 2


def test_no_more_refused_peers_are_named_than_can_be_read(
    context: Context, keyring: Keyring, monkeypatch: pytest.MonkeyPatch, logged: list[str]
) -> None:
    monkeypatch.setattr(gate_module, "MAX_NAMED", 3)
    hall = Hall(context, keyring, "tcp://127.0.0.1:*")
    for number in range(6):
        hall.listener(keyring.client(f"stranger{number}"))
        hall.tend_until(lambda number=number: hall.gate.rejected["unknown_key"] > number)
    assert len(logged) == 4
    assert logged[-1].startswith("more peers are refused")


def _can_bind(host: str) -> bool:
    try:
        plain.create_server((host, 0)).close()
    except OSError:
        return False
    return True
