import time
from collections.abc import Callable

import pytest
import zmq

from protocol import sockets
from protocol.security.authenticator import Authenticator
from protocol.security.link_keys import ClientKeys
from protocol.security.socket_monitor import HandshakeMonitor
from protocol.sockets import Context
from tests.support.keyring import Keyring
from tests.support.nodes import free_address
from tests.support.waiting import PATIENCE_S


class Connecting:
    """Two sockets that connect to an address, with a monitor."""

    def __init__(self, context: Context, address: str, keys: ClientKeys | None) -> None:
        self.monitor = HandshakeMonitor(context, keys)
        self.sockets = [sockets.unconnected(context, zmq.SUB, keys) for _ in range(2)]
        self._now_ns = 0
        for socket in self.sockets:
            self.monitor.watch(socket)
            socket.subscribe(b"")
            socket.connect(address)

    def poll_until(
        self, done: Callable[[], object], authenticator: Authenticator | None = None
    ) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.monitor.rejected
            if authenticator is not None:
                authenticator.poll(time.perf_counter_ns())
            self._now_ns += 1_000_000_000
            self.monitor.poll(self._now_ns)
            time.sleep(0.002)


@pytest.mark.parametrize(
    ("own", "peer", "cause", "reason"),
    [
        ("thumb", "wrist", "refused_key", "does not allow the key of thumb; there: telepulse"),
        ("finger", "other", "handshake", "breaks off: it is not other, whose public key"),
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
