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
