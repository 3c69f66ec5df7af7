import select
import socket as plain
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import pytest
import zmq

from protocol import sockets
from protocol.security.allow_list import UNREADABLE_AT_MOST_NS
from protocol.security.authenticator import Authenticator
from protocol.security.handshakes import HandshakeMonitor
from protocol.security.link_keys import ClientKeys
from protocol.sockets import Context
from tests.support.keyring import Keyring
from tests.support.nodes import free_address
from tests.support.waiting import PATIENCE_S

QUIET_S = 0.3


class Connecting:
    """Sockets that connect to an address, with a monitor."""

    def __init__(
        self, context: Context, address: str, keys: ClientKeys | None, count: int = 2
    ) -> None:
        self.monitor = HandshakeMonitor(context, keys)
        self.sockets = [sockets.unconnected(context, zmq.SUB, keys) for _ in range(count)]
        self.link = self.monitor.watch(self.sockets, lambda: address)
        self._address = address
        self._now_ns = 0
        # Time that the authenticator's clock is ahead.
        self.skipped_ns = 0
        for socket in self.sockets:
            socket.subscribe(b"")
            socket.connect(address)

    def poll_until(
        self, done: Callable[[], object], authenticator: Authenticator | None = None
    ) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.monitor.rejected
            if authenticator is not None:
                authenticator.poll(time.perf_counter_ns() + self.skipped_ns)
            self._now_ns += 1_000_000_000
            self.monitor.poll(self._now_ns)
            time.sleep(0.002)

    def reconnect_until(self, done: Callable[[], object], authenticator: Authenticator) -> None:
        """Connect again until `done`, since ZeroMQ does not after a refusal; a display does."""
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.monitor.rejected
            again_s = time.monotonic() + 1.0
            for socket in self.sockets:
                sockets.reconnect(socket, self._address, self._address)
            self.poll_until(lambda end=again_s: done() or time.monotonic() > end, authenticator)


@contextmanager
def far_away(port: int, one_way_s: float) -> Iterator[int]:
    """Yield a port of this machine whose first connection reaches `port` over a long way.

    Each piece arrives `one_way_s` after it was sent, or later, and the connection's end too.
    """
    with plain.create_server(("127.0.0.1", 0)) as listening, ExitStack() as connections:

        def carry() -> None:
            near = connections.enter_context(listening.accept()[0])
            far = connections.enter_context(plain.create_connection(("127.0.0.1", port)))
            while True:
                for source in select.select([near, far], (), ())[0]:
                    data = source.recv(1 << 16)
                    time.sleep(one_way_s)
                    if not data:
                        far.close()
                        return
                    (far if source is near else near).sendall(data)

        carrier = threading.Thread(target=carry)
        carrier.start()
        yield listening.getsockname()[1]
        carrier.join(PATIENCE_S)
        assert not carrier.is_alive()


@contextmanager
def started(keyring: Keyring, address: str) -> Iterator[Authenticator]:
    """Yield the authenticator of a sensing node's port, which ends with the block."""
    node = zmq.Context()
    try:
        authenticator = Authenticator(node, keyring.server())
        data = sockets.bind(node, zmq.PUB, address, authenticator)
        yield authenticator
        data.close(0)
    finally:
        node.destroy(linger=0)


def test_a_refusal_over_a_long_way_is_one_refusal_at_either_end(
    context: Context, keyring: Keyring, address: str, logged: list[str]
) -> None:
    """As the client hangs up a round trip later, long after the node has refused its key."""
    authenticator = Authenticator(context, keyring.server())
    sockets.bind(context, zmq.PUB, address, authenticator)
    with far_away(int(address.rpartition(":")[2]), 0.02) as port:
        far = f"tcp://127.0.0.1:{port}"
        display = Connecting(context, far, keyring.client("thumb"), count=1)
        display.poll_until(lambda: display.monitor.rejected, authenticator)
        end_s = time.monotonic() + QUIET_S
        display.poll_until(lambda: time.monotonic() > end_s, authenticator)
    assert authenticator.rejected == {"unknown_key": 1}
    assert display.monitor.rejected == {"refused_key": 1}
    assert len([line for line in logged if line.startswith("refused ")]) == 1


@pytest.mark.parametrize(
    ("own", "peer", "cause", "reason"),
    [
        ("thumb", "wrist", "refused_key", "does not allow the key of thumb; there: telepulse"),
        ("finger", "other", "handshake", "breaks off; it is not other, whose public key"),
        ("", "", "no_key", "requires a key; give --key and --peer"),
    ],
)
def test_a_refused_display_logs_the_reason_once(
    context: Context,
    keyring: Keyring,
    own: str,
    peer: str,
    cause: str,
    reason: str,
    logged: list[str],
) -> None:
    address = free_address()
    authenticator = Authenticator(context, keyring.server())
    sockets.bind(context, zmq.PUB, address, authenticator)
    display = Connecting(context, address, keyring.client(own, peer) if own else None)
    # ZeroMQ repeats a broken connection, but not a refused one.
    often = 8 if cause == "handshake" else 2
    display.poll_until(lambda: display.monitor.rejected[cause] >= often, authenticator)
    # The node may close the connection before its reason is read.
    assert set(display.monitor.rejected) <= {cause, "handshake"}
    lines = [line for line in logged if line.startswith(address)]
    assert all(line.startswith(f"{address} {reason}") for line in lines)
    assert len(lines) <= 1


def test_a_node_without_keys_is_reported_to_a_display_with_keys(
    context: Context, keyring: Keyring, logged: list[str], address: str
) -> None:
    sockets.bind(context, zmq.PUB, address)
    display = Connecting(context, address, keyring.client("finger"))
    display.poll_until(lambda: display.monitor.rejected["no_key"] >= 2)
    (line,) = logged
    assert line.startswith(f"{address} has no keys; start it with --key")


def test_an_unreadable_allow_list_is_not_reported_as_a_revocation(
    context: Context, keyring: Keyring, address: str, logged: list[str]
) -> None:
    authenticator = Authenticator(context, keyring.server())
    sockets.bind(context, zmq.PUB, address, authenticator)
    display = Connecting(context, address, keyring.client("finger"))
    monitor, link = display.monitor, display.link
    display.poll_until(lambda: len(monitor.established) == 2, authenticator)
    keyring.allowed.write_text("nonsense\n", encoding="utf-8")
    display.poll_until(lambda: logged, authenticator)
    display.skipped_ns = UNREADABLE_AT_MOST_NS
    display.poll_until(lambda: set(monitor.rejected) - {"handshake"}, authenticator)
    assert "revoked" not in monitor.rejected
    assert link.refusal is not None
    assert link.refusal.cause == "server_list_unreadable"
    assert link.refusal.reason.text.startswith(f"{address} cannot read its allow-list")
    assert "keys allow" not in str(link.refusal.reason)
    # The remedy works, and after it a revocation is one again.
    keyring.allowed.unlink()
    keyring.allow("finger")
    display.reconnect_until(lambda: len(monitor.established) == 2, authenticator)
    assert link.refusal is None
    keyring.allowed.unlink()
    display.poll_until(lambda: monitor.rejected["revoked"], authenticator)


def test_broken_handshakes_with_successes_between_them_are_no_refusal(
    context: Context, keyring: Keyring, address: str, logged: list[str]
) -> None:
    """As a sensing node breaks a handshake of each socket when it shuts down, and starts again."""
    display = Connecting(context, address, keyring.client("finger"), count=3)
    monitor = display.monitor
    for starts in range(1, 5):
        place = ("127.0.0.1", int(address.rpartition(":")[2]))
        with plain.create_server(place) as ending:
            for connection in [ending.accept()[0] for _ in display.sockets]:
                connection.close()
        with started(keyring, address) as authenticator:
            display.poll_until(lambda: len(monitor.established) == 3, authenticator)
        assert (display.link.refusal, logged) == (None, [])
        display.poll_until(lambda: not monitor.established)
        assert display.link.refusal is None, starts


def test_broken_handshakes_with_refusals_of_the_key_between_them_stay_refusals_of_the_key(
    context: Context, keyring: Keyring, address: str, logged: list[str]
) -> None:
    """As when a sensing node that refuses this display's key is started again and again."""
    display = Connecting(context, address, keyring.client("thumb"), count=1)
    refused = display.monitor.rejected
    for starts in range(1, 5):
        with plain.create_server(("127.0.0.1", int(address.rpartition(":")[2]))) as ending:
            if starts > 1:
                sockets.reconnect(display.sockets[0], address, address)
            ending.accept()[0].close()
        with started(keyring, address) as authenticator:
            display.poll_until(lambda n=starts: refused["refused_key"] >= n, authenticator)
        assert refused == {"refused_key": starts}
    assert len([line for line in logged if line.startswith(address)]) == 1


def test_a_refusal_ends_where_it_came_from_and_not_at_another_address_of_the_same_name(
    context: Context, keyring: Keyring, address: str
) -> None:
    display = Connecting(context, address, keyring.client("thumb"), count=1)
    (socket,), nobody = display.sockets, free_address()
    with started(keyring, address) as authenticator:
        display.poll_until(lambda: display.link.refusal, authenticator)
        sockets.reconnect(socket, address, nobody)
        display.poll_until(lambda: display.monitor.retried[socket] > 3, authenticator)
        assert display.link.refusal is not None
    sockets.reconnect(socket, nobody, address)
    display.poll_until(lambda: display.link.refusal is None)


def test_broken_handshakes_in_a_row_are_refusals_all_of_which_count(
    context: Context, keyring: Keyring, address: str, logged: list[str]
) -> None:
    display = Connecting(context, address, keyring.client("finger"), count=1)
    with plain.create_server(("127.0.0.1", int(address.rpartition(":")[2]))) as ending:
        for _ in range(3):
            ending.accept()[0].close()
        display.poll_until(lambda: display.link.refusal)
        assert display.monitor.rejected == {"handshake": 3}
        assert display.link.refusal is not None
        assert logged == [str(display.link.refusal.reason)]
