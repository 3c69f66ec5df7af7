import pytest
import zmq

from display_node.telemetry.publisher import Publisher
from protocol import sockets
from protocol.sockets import Context
from protocol.ticks import TickState
from protocol.wire.telemetry import (
    CAPTURE,
    CONTROL,
    STATUS,
    STATUS_TRACES,
    TRACE,
    TRACE_TICKS,
    CapturedMessage,
    read_capture,
    read_trace,
)
from tests.support.live_display import PATIENCE_S, subscribe
from tests.support.nodes import free_address
from tests.support.waiting import until


def ticks(publisher: Publisher, count: int) -> int:
    """Add ticks and publish them when due; return the number of statuses that become due."""
    states = (TickState(now_ns=number) for number in range(count))
    return sum(publisher.add(state) and publisher.publish() for state in states)


def received(socket: zmq.Socket) -> list[tuple[bytes, bytes]]:
    """Return the messages that arrive until 0.3 s of silence."""
    messages = []
    while socket.poll(300):
        messages.append(tuple(socket.recv_multipart()))
    return messages


@pytest.fixture
def publisher(context: Context) -> Publisher:
    return Publisher(sockets.bind(context, zmq.XPUB, free_address()), run=1)


@pytest.fixture
def everything(publisher: Publisher, context: Context) -> zmq.Socket:
    return subscribe(context, publisher.address)


def test_captured_messages_are_sent_on_request_only(
    publisher: Publisher, everything: zmq.Socket
) -> None:
    assert not publisher.await_recorder(0.3)
    publisher.captured.add(1, 0, b"frame")
    assert ticks(publisher, STATUS_TRACES * TRACE_TICKS) == 1
    publisher.status(b"status")
    assert [topic for topic, _ in received(everything)] == [TRACE] * STATUS_TRACES + [STATUS]


def test_each_recorder_receives_the_stream_description_however_late_it_comes(
    publisher: Publisher, context: Context
) -> None:
    publisher.captured.add(1, CONTROL, b"welcome")
    publisher.captured.welcome(1, b"welcome")
    for _ in range(2):
        reader = context.socket(zmq.SUB)
        reader.subscribe(CAPTURE)
        reader.connect(publisher.address)

        def arrived(reader: zmq.Socket = reader) -> bool:
            ticks(publisher, TRACE_TICKS)
            return bool(reader.poll(20))

        until(arrived)
        captured = read_capture(reader.recv_multipart()[1])
        assert captured.messages == [CapturedMessage(1, CONTROL, b"welcome")]


def test_the_last_ticks_and_messages_come_before_the_last_status(
    publisher: Publisher, everything: zmq.Socket
) -> None:
    everything.subscribe(CAPTURE)
    assert publisher.await_recorder(PATIENCE_S)
    ticks(publisher, TRACE_TICKS + 3)
    publisher.captured.add(5, 0, b"last")
    publisher.finish(b"status")
    messages = received(everything)
    traces = [read_trace(data)[0] for topic, data in messages if topic == TRACE]
    assert [len(trace.now_ns) for trace in traces] == [TRACE_TICKS, 3]
    captured = [read_capture(data) for topic, data in messages if topic == CAPTURE]
    assert [m for part in captured for m in part.messages] == [CapturedMessage(5, 0, b"last")]
    assert captured[-1].traces_published == 2
    assert messages[-1] == (STATUS, b"status")
