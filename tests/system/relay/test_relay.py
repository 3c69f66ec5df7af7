"""Relays between raw peers, in threads of the test."""

import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import zmq

from protocol import sockets
from protocol.errors import AddressError
from protocol.security.allow_list import allow, revoke
from protocol.security.keys import ClientKeys, KeyPair, ServerKeys, new_pair, read_pair
from protocol.sockets import Context, Socket, control_address
from protocol.summary.tables import Summary
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


def bound(context: Context, kind: int, address: str) -> Socket:
    """Bind a socket once the address is free."""
    made: list[Socket] = []

    def bind() -> bool:
        with suppress(AddressError):
            made.append(sockets.bind(context, kind, address))
        return bool(made)

    until(bind)
    return made[0]


class Sensing:
    """A sensing node's sockets."""

    def __init__(self, context: Context, address: str) -> None:
        self.data = bound(context, zmq.PUB, address)
        self.control = bound(context, zmq.ROUTER, control_address(address))
        self.control.setsockopt(zmq.RCVTIMEO, int(PATIENCE_S * 1000))

    def question(self) -> list[bytes]:
        """Return the next question, with its envelope."""
        return self.control.recv_multipart()

    def close(self) -> None:
        self.data.close(0)
        self.control.close(0)


class Raw:
    """A display's sockets."""

    def __init__(self, context: Context, address: str, keys: ClientKeys | None = None) -> None:
        self.data = sockets.connect(context, zmq.SUB, address, keys)
        self.data.subscribe(b"")
        self.control = sockets.connect(context, zmq.DEALER, control_address(address), keys)
        for socket in (self.data, self.control):
            socket.setsockopt(zmq.RCVTIMEO, int(PATIENCE_S * 1000))


def published(data: Socket, received: Socket, texts: Iterator[bytes]) -> bytes:
    """Publish messages one after the other; return the first that arrives."""
    until(lambda: data.send(next(texts)) or received.poll(20))
    return received.recv()


def numbered() -> Iterator[bytes]:
    return (b"%d" % number for number in itertools.count())


def test_without_subscriptions_nothing_is_sent(context: Context) -> None:
    inner, outer = free_address(), free_address()
    data = sockets.bind(context, zmq.XPUB, inner)
    with relaying(inner, outer) as end:
        assert not data.poll(300)
        one, another = Raw(context, outer), Raw(context, outer)
        # One subscription, whatever the number of displays.
        assert data.recv() == b"\1"
        for display in (one, another):
            published(data, display.data, numbered())
        assert not data.poll(0)
        one.data.unsubscribe(b"")
        assert not data.poll(100)
        another.data.unsubscribe(b"")
        assert data.recv() == b"\0"
        assert end().frames.received


def test_a_sensing_node_that_is_started_again_is_received_again(context: Context) -> None:
    inner, outer = free_address(), free_address()
    sensing, display = Sensing(context, inner), Raw(context, outer)
    with relaying(inner, outer):
        for _ in range(2):
            published(sensing.data, display.data, numbered())
            display.control.send(b"question")
            assert sensing.question()[-1] == b"question"
            sensing.close()
            sensing = Sensing(context, inner)


def test_a_relay_that_is_started_again_is_a_cut_that_has_ended(context: Context) -> None:
    inner, outer = free_address(), free_address()
    sensing, display = Sensing(context, inner), Raw(context, outer)
    for text in (b"one", b"two"):
        with relaying(inner, outer):
            published(sensing.data, display.data, iter([text] * 10_000))
            display.control.send(text)
            assert sensing.question()[-1] == text


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
    upstream, downstream = ClientKeys(own, wrist.public), ServerKeys(own, allowed)
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
        until(lambda: any(finger.public.key.hex() in line for line in logged))
        summary = end()
    assert summary.rejected["unknown_key"] >= 1
    # Either side may detect the missing key first.
    assert {"no_key", "handshake"} & set(summary.rejected)
    assert sum(stranger.public.key.hex() in line for line in logged) == 1


def pair(folder: Path, name: str) -> KeyPair:
    secret, _ = new_pair(folder, name)
    return read_pair(secret)
