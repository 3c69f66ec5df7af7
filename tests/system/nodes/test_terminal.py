"""Terminal view of telemetry over real sockets."""

import io
import time
from collections.abc import Callable

import zmq
from rich.console import Console

from display_node.telemetry.terminal import watch
from protocol.finger import FingerState
from protocol.sockets import Context
from protocol.summary.fields import Summary
from protocol.ticks import TickState
from protocol.wire.marks import MARK, Mark, pack_mark
from protocol.wire.telemetry import STATUS, TRACE, pack_status
from tests.support.nodes import free_address
from tests.support.tick_blocks import packed_trace

SECOND_NS = 1_000_000_000
PLAYING = pack_status("playing", "my pulse", Summary(finger=FingerState(0.356)), final=False)


def message_at(now_ns: int) -> bytes:
    """A trace message of one tick at full strength."""
    return packed_trace(TickState(now_ns=now_ns, felt_n=0.356, full=True))


def shown(context: Context, send: Callable[[zmq.Socket[bytes]], None]) -> str:
    """Return the output of a terminal until a line names a state; `send` publishes telemetry."""
    address, output = free_address(), io.StringIO()
    publisher = context.socket(zmq.XPUB)
    publisher.bind(address)
    end_s = time.monotonic() + 30.0
    subscriptions = 0

    def look() -> bool:
        nonlocal subscriptions
        while subscriptions < 3 and publisher.poll(10):
            publisher.recv()
            subscriptions += 1
            if subscriptions == 3:
                send(publisher)
        return ": " not in output.getvalue() and time.monotonic() < end_s

    watch(address, Console(file=output, width=500), keep_watching=look)
    return output.getvalue()


def test_a_mark_is_printed(context: Context) -> None:
    mark = pack_mark(Mark(1, 1, 0, "cuff on"))
    text = shown(context, lambda publisher: publisher.send_multipart((MARK, mark)))
    assert text.endswith("mark: cuff on\n")


def test_queued_telemetry_of_a_display_that_stalled_is_shown_with_its_age(
    context: Context,
) -> None:

    def send(publisher: zmq.Socket[bytes]) -> None:
        now_ns = time.perf_counter_ns()
        publisher.send_multipart((TRACE, message_at(now_ns - 5 * SECOND_NS)))
        publisher.send_multipart((STATUS, PLAYING))

    line = shown(context, send)
    assert line.startswith(("playing 5.", "playing 6.")), line
    assert "no telemetry: since" in line
