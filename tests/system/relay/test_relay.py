"""Relays between raw peers, in threads of the test."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import zmq

from protocol import sockets
from protocol.security.allow_list import AllowList, allow, revoke
from protocol.security.keys import KeyPair, new_pair, read_pair
from protocol.security.link_keys import ClientKeys, ServerKeys
from protocol.sockets import Context, control_address
from protocol.summary.fields import Summary
from telepulse.relay import Relay
from tests.support.nodes import free_address
from tests.support.waiting import PATIENCE_S, until


@contextmanager
def relaying(
    connect: str,
    bind: str,
    client_keys: ClientKeys | None = None,
    server_keys: ServerKeys | None = None,
) -> Iterator[Callable[[], Summary]]:
    """Run a relay in a thread; yield the function that ends it and returns its summary."""
    relay = Relay(connect, bind, client_keys, server_keys)
    summaries: list[Summary] = []
    thread = threading.Thread(target=lambda: summaries.append(relay.run()))
    thread.start()

    def end() -> Summary:
        relay.stop()
        thread.join(PATIENCE_S)
        return summaries[0]

    try:
        yield end
    finally:
        end()


class Sensing:
    """A sensing node's sockets."""

    def __init__(self, context: Context, address: str) -> None:
        self.data = sockets.bind(context, zmq.PUB, address)
        self.control = sockets.bind(context, zmq.ROUTER, control_address(address))
        self.control.setsockopt(zmq.RCVTIMEO, int(PATIENCE_S * 1000))

    def question(self) -> list[bytes]:
        """Return the next question, with its envelope."""
        return self.control.recv_multipart()


class Raw:
    """A display's sockets."""

    def __init__(self, context: Context, address: str, keys: ClientKeys | None = None) -> None:
        self.data = sockets.connect(context, zmq.SUB, address, keys)
        self.data.subscribe(b"")
        self.control = sockets.connect(context, zmq.DEALER, control_address(address), keys)
        for socket in (self.data, self.control):
            socket.setsockopt(zmq.RCVTIMEO, int(PATIENCE_S * 1000))


def test_an_unanswered_question_makes_it_connect_anew(context: Context, logged: list[str]) -> None:
    inner, outer = free_address(), free_address()
    sensing, display = Sensing(context, inner), Raw(context, outer)
    with relaying(inner, outer):
        display.control.send(b"question")
        first, *_ = sensing.question()
        # Its connection breaks for good: one message above the limit ends it.
        sensing.control.send_multipart([first, b"", bytes(4 * 65_536 + 1)])

        def another() -> bool:
            display.control.send(b"again")
            return bool(sensing.control.poll(50)) and sensing.question()[0] != first

        until(another)
        assert any("silent" in line for line in logged)


def test_with_keys_it_admits_allowed_keys_and_is_admitted_where_its_own_is_allowed(
    context: Context, tmp_path: Path, logged: list[str]
) -> None:
    wrist, own, finger, stranger = (pair(tmp_path, n) for n in ("wrist", "own", "finger", "odd"))
    allowed = tmp_path / "allowed"
    allow(allowed, finger.public)
    inner, outer = free_address(), free_address()
    sensing = sockets.unconnected(context, zmq.ROUTER)
    sensing.setsockopt(zmq.CURVE_SERVER, 1)
    sensing.setsockopt(zmq.CURVE_SECRETKEY, wrist.secret)
    sensing.setsockopt(zmq.RCVTIMEO, int(PATIENCE_S * 1000))
    sensing.bind(control_address(inner))
    upstream, downstream = ClientKeys(own, wrist.public), ServerKeys(own, AllowList(allowed))
    with relaying(inner, outer, client_keys=upstream, server_keys=downstream) as end:
        odd = Raw(context, outer, ClientKeys(stranger, own.public))
        keyless = Raw(context, outer)
        friend = Raw(context, outer, ClientKeys(finger, own.public))
        for display, text in ((odd, b"odd"), (keyless, b"keyless"), (friend, b"friend")):
            display.control.send(text)
        *envelope, question = sensing.recv_multipart()
        assert question == b"friend"
        sensing.send_multipart([*envelope, b"answer"])
        assert friend.control.recv() == b"answer"
        revoke(allowed, "finger")
        until(lambda: f"refused 127.0.0.1: {finger.public} is no longer allowed" in logged)
        summary = end()
    assert summary.rejected["unknown_key"] >= 1
    # Either side may detect the missing key first.
    assert {"no_key", "handshake"} & set(summary.rejected)
    assert sum(stranger.public.key.hex() in line for line in logged) == 1


def pair(folder: Path, name: str) -> KeyPair:
    secret, _ = new_pair(folder, name)
    return read_pair(secret)
