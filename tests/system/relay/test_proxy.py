import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest
import zmq

from protocol import sockets
from protocol.sockets import Context, Socket
from telepulse.relay import Proxy
from tests.support.nodes import free_address
from tests.support.waiting import PATIENCE_S, until

QUEUED = 3_000


class Ends:
    """A display and a sensing node with a control proxy between them."""

    def __init__(self, context: Context) -> None:
        inner, outer = free_address(), free_address()
        self.inner, self.outer = inner, outer
        self.display = sockets.connect(context, zmq.DEALER, outer)
        self.sensing = sockets.unconnected(context, zmq.ROUTER)
        for end in (self.display, self.sensing):
            end.setsockopt(zmq.RCVTIMEO, int(PATIENCE_S * 1000))
        upstream = sockets.unconnected(context, zmq.DEALER)
        upstream.connect(inner)
        self.proxy = Proxy(context, sockets.bind(context, zmq.ROUTER, outer), upstream)

    def begin(self) -> None:
        self.sensing.bind(self.inner)
        self.proxy.start()


@pytest.fixture
def ends(context: Context) -> Iterator[Ends]:
    ends = Ends(context)
    yield ends
    ends.proxy.stop()


def recorded(send: Callable[..., object], sent: list[bytes]) -> Callable[..., object]:
    """Return a function that sends, and keeps what it sends."""

    def record(socket: Socket, data: bytes, *arguments: object, **options: object) -> object:
        sent.append(data)
        return send(socket, data, *arguments, **options)

    return record


def count_until(proxy: Proxy, met: Callable[[], bool]) -> None:
    until(lambda: proxy.update_counts() or met())


def answer(sensing: Socket, text: bytes) -> bytes:
    *envelope, question = sensing.recv_multipart()
    sensing.send_multipart([*envelope, text])
    return question


def test_a_flood_without_a_sensing_node_neither_blocks_it_nor_garbles_later_messages(
    ends: Ends, context: Context
) -> None:
    # ZeroMQ's proxy looks for room once in a burst of a thousand messages, of which one is sent.
    ends.proxy.start()
    ends.display.send(b"question")
    count_until(ends.proxy, lambda: ends.proxy.requests == 2)  # an address, a text
    ends.proxy.stop()
    another = sockets.connect(context, zmq.DEALER, ends.outer)
    for _ in range(QUEUED // 2):
        ends.display.send(b"question")
        another.send(b"question")
    time.sleep(0.3)
    ends.proxy.start()
    until(lambda: ends.proxy.dropped)
    stopping = threading.Thread(target=ends.proxy.stop)
    stopping.start()
    stopping.join(PATIENCE_S)
    assert not stopping.is_alive()
    ends.begin()
    received = [ends.sensing.recv_multipart()]
    ends.sensing.setsockopt(zmq.RCVTIMEO, 500)
    with suppress(zmq.Again):
        while True:
            received.append(ends.sensing.recv_multipart())
    assert sockets.HIGH_WATER_FRAMES <= len(received) <= QUEUED
    assert {tuple(parts[-1:]) for parts in received} == {(b"question",)}
    assert {len(parts) for parts in received} == {3}
    ends.display.send(b"last")
    assert answer(ends.sensing, b"answer") == b"last"
    assert ends.display.recv() == b"answer"


def test_figures_are_right_again_after_an_answer_that_came_late(ends: Ends) -> None:
    ends.begin()

    def ask(count: int) -> None:
        for _ in range(count):
            ends.display.send(b"question")
            answer(ends.sensing, b"answer")
            ends.display.recv()

    ask(3)
    steering = ends.proxy._steering
    assert steering is not None
    # As if `update_counts` had not waited for its answer.
    steering.send(b"STATISTICS")
    until(lambda: sockets.has_message(steering))
    ask(7)
    ends.proxy.update_counts()
    # Each has an address and a text.
    assert ends.proxy.requests == ends.proxy.received == 2 * (3 + 7)


def test_a_proxy_that_does_not_end_is_not_waited_for_without_end(
    ends: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    monkeypatch.setattr("telepulse.relay.ANSWER_MS", 50)
    monkeypatch.setattr(zmq, "proxy_steerable", lambda *_: released.wait())
    ends.proxy.start()
    asked = []
    monkeypatch.setattr(zmq.Socket, "send", recorded(zmq.Socket.send, asked))
    for _ in range(5):
        ends.proxy.update_counts()
    # It is asked once, and not waited for at each update.
    assert asked == [b"STATISTICS"]
    stopped: list[bool] = []
    stopping = threading.Thread(target=lambda: stopped.append(ends.proxy.stop()))
    stopping.start()
    stopping.join(PATIENCE_S)
    still_waiting = stopping.is_alive()
    released.set()
    stopping.join()
    assert not still_waiting
    # Its sockets are not the caller's yet.
    assert stopped == [False]
    assert ends.proxy.stop()


def test_a_proxy_that_has_ended_by_itself_is_stopped(
    ends: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("telepulse.relay.ANSWER_MS", 50)
    monkeypatch.setattr(zmq, "proxy_steerable", lambda *_: None)
    ends.proxy.start()
    ends.proxy._thread.join()
    stopped: list[bool] = []
    stopping = threading.Thread(target=lambda: stopped.append(ends.proxy.stop()), daemon=True)
    stopping.start()
    stopping.join(PATIENCE_S)
    assert stopped == [True]
