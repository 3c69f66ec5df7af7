import time

import pytest
import zmq

from display_node.telemetry.publisher import Publisher
from protocol import sockets
from protocol.sockets import Context
from protocol.wire.telemetry import (
    CONTROL,
    HEARD,
    STATUS,
    STATUS_TRACES,
    TRACE,
    TRACE_TICKS,
    CapturedMessage,
    CapturedMessages,
    TickState,
    read_capture,
    read_trace,
)
from tests.support.live_display import PATIENCE_S, subscribe
from tests.support.nodes import free_address


def ticks(publisher: Publisher, count: int) -> int:
    """How many statuses are due on the way."""
    return sum(publisher.add(TickState(now_ns=number)) for number in range(count))


def received(socket: zmq.Socket) -> list[tuple[bytes, bytes]]:
    """All that comes within a moment."""
    messages = []
    while socket.poll(300):
        messages.append(tuple(socket.recv_multipart()))
    return messages


def heard_by(socket: zmq.Socket, publisher: Publisher) -> CapturedMessages:
    """The first of what was heard that reaches a reader which has just come."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        ticks(publisher, TRACE_TICKS)
        if socket.poll(20):
            return read_capture(socket.recv_multipart()[1])
    pytest.fail("nothing came")


@pytest.fixture
def publisher(context: Context) -> Publisher:
    return Publisher(sockets.bind(context, zmq.XPUB, free_address()), run=1)


def test_who_does_not_ask_for_what_was_heard_does_not_get_it(
    publisher: Publisher, context: Context
) -> None:
    everything = subscribe(context, publisher.address)
    assert not publisher.await_recorder(0.3)
    publisher.heard.add(1, 0, b"frame")
    assert ticks(publisher, STATUS_TRACES * TRACE_TICKS) == 1
    publisher.status(b"status")
    assert [topic for topic, _ in received(everything)] == [TRACE] * STATUS_TRACES + [STATUS]


def test_each_recorder_is_told_of_the_stream_however_late_it_comes(
    publisher: Publisher, context: Context
) -> None:
    publisher.heard.add(1, CONTROL, b"welcome")
    publisher.heard.welcome(1, b"welcome")
    for _ in range(2):
        reader = context.socket(zmq.SUB)
        reader.subscribe(HEARD)
        reader.connect(publisher.address)
        assert heard_by(reader, publisher).messages == [CapturedMessage(1, CONTROL, b"welcome")]


def test_the_last_ticks_and_messages_come_before_the_last_status(
    publisher: Publisher, context: Context
) -> None:
    everything = subscribe(context, publisher.address)
    everything.subscribe(HEARD)
    assert publisher.await_recorder(PATIENCE_S)
    ticks(publisher, TRACE_TICKS + 3)
    publisher.heard.add(5, 0, b"last")
    publisher.finish(b"status")
    messages = received(everything)
    traces = [read_trace(data) for topic, data in messages if topic == TRACE]
    assert [len(trace.now_ns) for trace in traces] == [TRACE_TICKS, 3]
    heard = [read_capture(data) for topic, data in messages if topic == HEARD]
    assert [m for part in heard for m in part.messages] == [CapturedMessage(5, 0, b"last")]
    assert heard[-1].traces == 2
    assert messages[-1] == (STATUS, b"status")
