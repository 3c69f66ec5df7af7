import time
from collections.abc import Callable
from pathlib import Path

import pytest
import zmq

from protocol import sockets
from protocol.security.allow_list import revoke
from protocol.security.authenticator import Authenticator
from protocol.security.keys import ClientKeys
from protocol.security.socket_monitor import HandshakeMonitor
from protocol.sockets import Context
from tests.support.keyring import Keyring
from tests.support.nodes import free_address

PATIENCE_S = 20.0


class Visitor:
    """Connects to an address and listens to why it cannot."""

    def __init__(self, context: Context, address: str, keys: ClientKeys | None) -> None:
        self.refusals = HandshakeMonitor(context, keys)
        self.sockets = [sockets.unconnected(context, zmq.SUB, keys) for _ in range(2)]
        self._now_ns = 0
        for socket in self.sockets:
            self.refusals.watch(socket)
            socket.subscribe(b"")
            socket.connect(address)

    def tend_until(self, done: Callable[[], object], gate: Authenticator | None = None) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.refusals.rejected
            if gate is not None:
                gate.poll(time.monotonic_ns())
            self._now_ns += 1_000_000_000
            self.refusals.poll(self._now_ns)
            time.sleep(0.002)


@pytest.fixture
def keyring(tmp_path: Path) -> Keyring:
    return Keyring(tmp_path / "keys")


@pytest.mark.parametrize(
    ("own", "peer", "cause", "reason"),
    [
        ("finger", "wrist", "refused_key", "does not allow the key of finger; there: telepulse"),
        ("finger", "other", "handshake", "breaks off: it is not other, whose public key"),
        ("", "", "no_key", "requires a key; give --key and --peer"),
    ],
)
def test_who_is_refused_is_told_why_once(
    context: Context,
    keyring: Keyring,
    own: str,
    peer: str,
    cause: str,
    reason: str,
    logged: list[str],
) -> None:
    address = free_address()
    gate = Authenticator(context, keyring.server())
    sockets.bind(context, zmq.PUB, address, gate)
    visitor = Visitor(context, address, keyring.client(own, peer) if own else None)
    # ZeroMQ itself tries again where the other breaks off, and no more where it is refused.
    often = 8 if cause == "handshake" else 2
    visitor.tend_until(lambda: visitor.refusals.rejected[cause] >= often, gate)
    # The other may break off before it is heard why.
    assert set(visitor.refusals.rejected) <= {cause, "handshake"}
    lines = [line for line in logged if line.startswith(address)]
    assert all(line.startswith(f"{address} {reason}") for line in lines)
    assert len(lines) <= 1


def test_who_was_let_in_and_is_refused_later_is_told_that_it_was_revoked(
    context: Context, keyring: Keyring, logged: list[str]
) -> None:
    address = free_address()
    keyring.allow("finger")
    gate = Authenticator(context, keyring.server())
    socket = sockets.bind(context, zmq.PUB, address, gate)
    visitor = Visitor(context, address, keyring.client("finger"))
    waiting = list(visitor.sockets)

    def both_receive() -> bool:
        sockets.send(socket, b"a frame")
        waiting[:] = [each for each in waiting if not list(sockets.receive_all(each))]
        return not waiting

    visitor.tend_until(both_receive, gate)
    revoke(keyring.allowed, "finger")
    visitor.tend_until(lambda: visitor.refusals.rejected["revoked"] >= 2, gate)
    (line,) = (line for line in logged if line.startswith(address))
    assert line.startswith(f"{address} has revoked the key of finger")
    assert "refused_key" not in visitor.refusals.rejected


@pytest.mark.parametrize("keyed", [True, False])
def test_what_is_no_node_with_keys_is_told_of(
    context: Context, keyring: Keyring, keyed: bool, logged: list[str]
) -> None:
    address = free_address()
    sockets.bind(context, zmq.PUB, address)
    visitor = Visitor(context, address, keyring.client("finger") if keyed else None)
    if keyed:
        visitor.tend_until(lambda: visitor.refusals.rejected["no_key"] >= 2)
        (line,) = logged
        assert line.startswith(f"{address} has no keys; start it with --key")
    else:
        visitor.tend_until(lambda: time.monotonic() % 1 < 0.5)
        assert logged == []
        assert visitor.refusals.rejected == {}
