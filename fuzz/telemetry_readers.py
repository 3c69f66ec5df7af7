"""All readers of a display's telemetry side by side, and properties that hold of each of them."""

import io
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console

from display_node.telemetry.terminal_view import TerminalView
from protocol.summary.fields import Clock, SampleCounts, Summary
from protocol.wire.description import StreamDescription
from protocol.wire.telemetry import (
    CAPTURE,
    CONTROL,
    STATUS,
    SUBSCRIBED,
    CaptureWriter,
    PlaybackStatus,
    pack_status,
)
from telepulse.lsl_outlet import LslForwarder
from telepulse.metrics.server import NodeState as ReportedStatus
from telepulse.metrics.server import families
from telepulse.recording.contents import RecordingContents
from telepulse.recording.findings import RunFindings
from telepulse.recording.mcap_writer import as_json
from telepulse.telemetry.decoder import TelemetryDecoder
from telepulse.view.live import MAX_CONTACTORS, LiveState
from telepulse.view.page import padded
from telepulse.view.text import alarms, contactor_rows, figures, state
from telepulse.view.window_data import window_data, window_scores
from tests.support.telemetry_publisher import (
    MS,
    PLAYING,
    SESSION,
    WALL_NS,
    WELCOME,
    Message,
    clock_reply,
)

SECOND_NS = 1000 * MS
AHEAD_NS = 5 * SECOND_NS
MOST_CHARACTERS = 100_000


class TelemetryReaders:
    """All readers of telemetry: terminal, page, recorder, report, LSL and metrics."""

    def __init__(self) -> None:
        self.screen, self.live, self.decoder = TerminalView(), LiveState(), TelemetryDecoder()
        self.outlets = KeptOutlets()
        self.forwarder = LslForwarder(self.outlets)  # type: ignore[arg-type]
        self.contents = RecordingContents()

    def take(self, topic: bytes, data: bytes) -> None:
        """Pass a telemetry message to every reader."""
        self.screen.take((topic, data), 0)
        entries = self.decoder.decode(topic, data)
        for entry in entries:
            self.live.take(entry)
            # Every reader of JSON can read a recording.
            fields = json.loads(as_json(entry.fields), parse_constant=_refuse_constant)
            self.contents.take(entry._replace(fields=fields))
        self.forwarder.take(entries)

    def draw(self) -> None:
        """Draw what every reader shows; raise AssertionError where it cannot be shown."""
        console = Console(width=100, file=io.StringIO(), color_system=None)
        console.print(self.screen.live(3 * SECOND_NS), self.screen.line(3 * SECOND_NS))
        assert console.file.tell() < MOST_CHARACTERS
        for chosen, window_ns in enumerate((SECOND_NS, 10 * SECOND_NS)):
            drawn = window_data(self.live, window_ns, chosen)
            scores = window_scores(self.live, window_ns, chosen)
            rows = contactor_rows(self.live, scores)
            assert len(rows) == len(drawn.fingers) <= MAX_CONTACTORS
            assert all(text for row in rows for text in row)
            assert not any(np.isinf(finger["y"]).any() for finger in drawn.fingers)
            for low, high in drawn.limits.values():
                assert math.isfinite(low)
                assert math.isfinite(high)
                assert low < high
            assert not any(np.isinf(column).any() for column in padded(drawn.columns).values())
            assert all(figure.value for figure in figures(self.live, scores).values())
        assert all(alarm.name for alarm in alarms(self.live, 0))
        assert len(state(self.live)) == 2
        if self.screen.status is not None:
            reported = ReportedStatus(self.screen.status, 0, self.screen.heart_rates_per_min)
            for metric in families("fuzz", reported, 0):
                assert all(type(sample.value) in (int, float, bool) for sample in metric.samples)
        self.forwarder.finish()
        self.contents.finish()
        json.dumps(RunFindings(self.contents).summary().to_dict(), allow_nan=False)


class KeptOutlets:
    """A check of what LSL would publish, with the methods of `LslStreams`."""

    def local_clock(self) -> float:
        """Return a constant time."""
        return 0.0

    def describe(self, description: StreamDescription) -> bool:
        """Accept any stream."""
        return True

    def push_wrist(self, values: "np.ndarray[Any, Any]", times_s: Sequence[float]) -> None:
        """Check samples of the wrist."""
        assert np.isfinite(values).all()
        assert np.isfinite(times_s).all()

    def push_finger(
        self,
        contactors: Sequence[str],
        forces_n: Sequence[list[float]],
        times_s: list[float],
        pressed: bool = False,
    ) -> None:
        """Check forces at the finger."""
        assert np.shape(forces_n) == (len(times_s), 2 * len(contactors) + 2 * pressed)
        assert not np.isinf(forces_n).any()
        assert np.isfinite(times_s).all()

    def push_event(self, text: str, time_s: float) -> None:
        """Check an event."""
        assert math.isfinite(time_s)


def preamble(run: int = 1) -> list[Message]:
    """Return what a display publishes before a pulse is felt: stream, clock, status, frames."""
    heard = CaptureWriter(run)
    heard.follow(SUBSCRIBED)
    heard.add(0, CONTROL, WELCOME)
    for number in range(8):
        t1_ns = number * 25 * MS
        heard.add(t1_ns, CONTROL, clock_reply(t1_ns, AHEAD_NS))
    messages = [(CAPTURE, part) for part in heard.take(200 * MS, WALL_NS + 200 * MS)]
    return [*messages, status_message("playing")]


def status_message(state: str, *playing: PlaybackStatus, **changes: Any) -> Message:
    """Return a status message, of a display whose clock is known.

    playing: of each contactor; without any, of one.
    """
    whole: dict[str, Any] = {
        "clock": Clock(AHEAD_NS / MS, 1.0, 0.1, 0.2, 0),
        "samples": SampleCounts(5, 5, 0, 0, 0, 0),
    }
    summary = Summary(**(whole | changes))
    return STATUS, pack_status(
        state, "pulse", summary, False, SESSION, playing=playing or [PLAYING]
    )


def _refuse_constant(name: str) -> None:
    raise AssertionError(f"a recording holds {name}")
