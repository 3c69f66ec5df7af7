"""Traces, statuses and captured messages of a display, and every reader of them."""

import msgpack
import numpy as np

from display_node.telemetry.publisher import MarkCounter
from fuzz.refusals import refusals
from fuzz.telemetry_readers import TelemetryReaders, preamble
from protocol.summary.fields import Summary
from protocol.ticks import TickBlock, TickState
from protocol.wire.marks import MARK, Mark, MarkRequest, pack_mark, pack_request
from protocol.wire.telemetry import (
    CAPTURE,
    STATUS,
    TRACE,
    CaptureWriter,
    TraceWriter,
    read_capture,
    read_status,
    read_trace,
)

MSGPACK = True
TICKS = 20


def seeds() -> list[bytes]:
    """Return a trace, two statuses, captured messages, a mark and a request for one."""
    block, writer = TickBlock(1, TICKS), TraceWriter()
    for tick in range(TICKS):
        block.add([TickState(tick, tick, tick, 0.5, 0.4, True)])
    writer.add(block)
    statuses = [["playing", "pulse", Summary().to_dict(), final] for final in (False, True)]
    heard = CaptureWriter(run=7)
    heard.wanted = True
    for number in range(3):
        heard.add(number, number - 1, b"a message")
    packed = (msgpack.packb(status) for status in statuses)
    marks = [pack_mark(Mark(1, 2, 3, "cuff on")), pack_request(MarkRequest(2, 3, "cuff on"))[1:]]
    return [writer.rest() or b"", *packed, *heard.take(10, 20), *marks]


def try_one(data: bytes) -> None:
    """Decode and draw; a trace's columns have one length, and a status can be shown."""
    with refusals():
        for trace in read_trace(data):
            assert {np.shape(column) for column in trace} == {np.shape(trace.now_ns)}
    with refusals():
        assert all(type(message.data) is bytes for message in read_capture(data).messages)
    with refusals():
        read_status(data)
    mark = MarkCounter().take(data, 10)
    assert mark is None or mark.text.isprintable()
    readers = TelemetryReaders()
    for message in preamble():
        readers.take(*message)
    for topic in (TRACE, STATUS, CAPTURE, MARK):
        readers.take(topic, data)
    readers.draw()
