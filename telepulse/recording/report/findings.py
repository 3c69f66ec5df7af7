"""Findings about a recorded run, gathered in one pass."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from display_node.control.safety import SafetyScene
from protocol.counters import Availability
from protocol.errors import SourceError
from protocol.histogram import Histogram
from protocol.run_summary import Summary
from protocol.summary_tables import Loop, PlayoutDelay
from protocol.wire.messages import Frame
from telepulse.recording.reader import RecordingReader, in_tick_order
from telepulse.recording.report.forces import AlignedTick, ForceHistory
from telepulse.recording.report.trend import Trend
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.passive_receiver import PassiveReceiver
from telepulse.telemetry.schema import EVENT, STATUS, STREAM, TICK

MAX_EVENTS = 500
TICKS_A_BATCH = 1_000
# Bins of counts.
COUNT_WIDTH_S = 1.0
_SUMMARY = TypeAdapter(Summary)


@dataclass
class Trends:
    """Values over the time of the recording, in the units of their names."""

    one_way_ms: Trend = field(default_factory=Trend)
    playout_ms: Trend = field(default_factory=Trend)
    late: Trend = field(default_factory=lambda: Trend(COUNT_WIDTH_S))
    lost: Trend = field(default_factory=lambda: Trend(COUNT_WIDTH_S))
    offset_ms: Trend = field(default_factory=Trend)
    uncertainty_ms: Trend = field(default_factory=Trend)
    skew_ppm: Trend = field(default_factory=Trend)
    round_trip_ms: Trend = field(default_factory=Trend)
    misses: Trend = field(default_factory=lambda: Trend(COUNT_WIDTH_S))
    late_p99_us: Trend = field(default_factory=Trend)
    late_max_us: Trend = field(default_factory=Trend)


class RunFindings:
    """Findings about a recording, complete after `finish`.

    Attributes
    ----------
    whole, damaged, gaps, provenance
        As of `RecordingReader`.
    own : Summary or None
        The display's own summary of its last status.
    own_final : bool
        Whether that was its final status.
    forces : ForceHistory
        Forces at wrist and finger.
    events : list
        Time in s, level, name, text; further ones are counted in `more_events`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.whole = False
        self.damaged = 0
        self.gaps: list[str] = []
        self.provenance: list[dict[str, str]] = []
        self.begin_ns: int | None = None
        self.end_ns = 0
        self.ticks = 0
        self.runs = 0
        self.streams: list[str] = []
        self.own: Summary | None = None
        self.own_final = False
        self.trends = Trends()
        self.forces = ForceHistory()
        self.events: list[tuple[float, int, str, str]] = []
        self.more_events = 0
        self.playout_ms = Histogram(0.5, 8_000)
        self._receiver = PassiveReceiver()
        self._session: int | None = None
        self._offset_ms = 0.0
        self._steps: tuple[int | None, int | None] = (None, None)
        self._misses = self._scored = self._played = 0
        self._tick_ns = 0
        # Until the display's first status.
        self._stale_after_ns = SafetyScene().stale_after_ns
        self._last_now_ns: int | None = None
        self._batch: dict[str, list[tuple[float, float]]] = {}

    @property
    def one_way_delay_ms(self) -> Histogram:
        """One-way delays of all frames, as the display counts them."""
        return self._receiver.one_way_delay_ms

    @property
    def seconds(self) -> float:
        """Length in s."""
        return 0.0 if self.begin_ns is None else (self.end_ns - self.begin_ns) * 1e-9

    def summary(self) -> Summary:
        """Return the figures of a display's summary that follow from the recording."""
        summary = replace(
            self._receiver.summary(self._last_now_ns or 0),
            playout_delay_ms=PlayoutDelay(
                self.playout_ms.mean,
                self.playout_ms.quantile(0.99),
                self.playout_ms.beyond(p99=0.99),
            ),
            availability=self._availability(),
            loop=Loop(self.ticks, self._misses),
        )
        return self.forces.alignment.errors.scored(summary)

    def _availability(self) -> Availability:
        """Return the shares that follow from the ticks; the others need the display's own count."""
        ticks = self.ticks + self._misses
        if not ticks:
            return Availability()
        shares = (count / ticks for count in (self._scored, self._misses, self._played))
        felt, missed, played = shares
        seconds = ticks * self._tick_ns * 1e-9
        return Availability(seconds, felt, missed=missed, played=played)

    def take(self, entry: Entry) -> None:
        """Process a message of the recording, in the order of `in_tick_order`."""
        if self.begin_ns is None:
            self.begin_ns = entry.t_ns
        self.end_ns = max(self.end_ns, entry.t_ns)
        t_s = (entry.t_ns - self.begin_ns) * 1e-9
        if entry.topic == TICK:
            self._tick(t_s, entry.fields)
        elif entry.topic == STATUS:
            self._status(t_s, entry.fields)
        elif entry.topic == EVENT:
            self._event(t_s, entry.fields)
        else:
            self._received(t_s, entry)

    def finish(self) -> None:
        """End the recording."""
        self.forces.finish()
        for name in list(self._batch):
            self._flush(name)

    def _received(self, t_s: float, entry: Entry) -> None:
        receiver = self._receiver
        frame = self._receiver.take(entry.topic, entry.fields)
        if entry.topic == STREAM and receiver.session != self._session:
            self._session = receiver.session
            assert receiver.description is not None
            self.streams.append(receiver.description.name)
            self.forces.begin()
        if frame is not None:
            self._frame(t_s, frame, entry.fields["arrived_ns"])
        if "round_trip_ms" in entry.fields:
            self._add("round_trip_ms", t_s, entry.fields["round_trip_ms"])

    def _frame(self, t_s: float, frame: Frame, arrived_ns: int) -> None:
        receiver = self._receiver
        assert receiver.description is not None
        last_ns = frame.t_first_ns + (len(frame.values) - 1) * frame.period_ns
        self._add("one_way_ms", t_s, (receiver.clock.remote_ns(arrived_ns) - last_ns) * 1e-6)
        self.forces.alignment.add_frame(frame, receiver.description)

    def _tick(self, t_s: float, fields: dict[str, Any]) -> None:
        now_ns, instant_ns = fields["now_ns"], fields["instant_ns"]
        self.ticks += 1
        self._count_misses(now_ns)
        receiver = self._receiver
        self._receiver.play(instant_ns)
        if not receiver.ready:
            return
        sensing_now_ns, target_n = receiver.clock.remote_ns(now_ns), float(fields["target_n"])
        # Nothing is played before the first sample.
        if target_n and self._alive(sensing_now_ns, instant_ns):
            self._played += 1
            delay_ms = (sensing_now_ns - instant_ns) * 1e-6
            self.playout_ms.add(delay_ms)
            self._add("playout_ms", t_s, delay_ms)
        if fields["scored"]:
            self._scored += 1
            tick = AlignedTick(
                t_s, sensing_now_ns, instant_ns, target_n, float(fields.get("felt_n", math.nan))
            )
            self.forces.add_tick(tick)

    def _alive(self, sensing_now_ns: int, instant_ns: int) -> bool:
        """Return whether the stream was not stale, as the display judges that."""
        receiver = self._receiver
        newest_ns, delay_ns = receiver.buffer.newest_ns, receiver.delay.delay_ns
        if newest_ns is None or delay_ns is None:
            return False
        due_ns = newest_ns + self._stale_after_ns
        return instant_ns <= due_ns or sensing_now_ns - delay_ns <= due_ns

    def _count_misses(self, now_ns: int) -> None:
        """Count missed ticks: those due at multiples of the period that are not there."""
        last_ns, self._last_now_ns = self._last_now_ns, now_ns
        if last_ns is None or now_ns <= last_ns:
            return
        apart_ns = now_ns - last_ns
        self._tick_ns = min(self._tick_ns, apart_ns) if self._tick_ns else apart_ns
        self._misses += round(apart_ns / self._tick_ns) - 1

    def _status(self, t_s: float, fields: dict[str, Any]) -> None:
        new, playing = _SUMMARY.validate_python(fields["summary"]), fields.get("playing")
        if playing is not None:
            self._stale_after_ns = int(playing["stale_after_ns"])
            self.forces.alignment.set_playback(
                int(playing["channel"]), float(playing["force_ratio"])
            )
        last, self.own, self.own_final = self.own or Summary(), new, fields["final"]
        for name in ("late", "lost"):
            more = (getattr(new.samples, name) or 0) - (getattr(last.samples, name) or 0)
            self._add(name, t_s, more)
        self._add("misses", t_s, (new.loop.deadline_misses or 0) - (last.loop.deadline_misses or 0))
        self._add("late_p99_us", t_s, new.loop.late_us.p99)
        self._add("late_max_us", t_s, new.loop.late_us.max)
        clock = new.clock
        if clock.offset_ms is not None:
            if (self._session, clock.steps) != self._steps:
                # Another session or a clock step: offsets before do not compare.
                self._steps, self._offset_ms = (self._session, clock.steps), clock.offset_ms
            self._add("offset_ms", t_s, clock.offset_ms - self._offset_ms)
            self._add("uncertainty_ms", t_s, clock.uncertainty_ms)
            self._add("skew_ppm", t_s, clock.skew_ppm)

    def _event(self, t_s: float, fields: dict[str, Any]) -> None:
        self.runs += fields["name"] == "begin"
        if len(self.events) < MAX_EVENTS:
            self.events.append((t_s, fields["level"], fields["name"], fields["message"]))
        else:
            self.more_events += 1

    def _add(self, name: str, t_s: float, value: float | None) -> None:
        if value is None:
            return
        batch = self._batch.setdefault(name, [])
        batch.append((t_s, value))
        if len(batch) >= TICKS_A_BATCH:
            self._flush(name)

    def _flush(self, name: str) -> None:
        points = np.array(self._batch.pop(name), float)
        trend: Trend = getattr(self.trends, name)
        trend.add(points[:, 0], points[:, 1])


def read_findings(path: Path) -> RunFindings:
    """Read a recording to its end, whole or not. Raises SourceError."""
    reader, findings = RecordingReader(path), RunFindings(path)
    try:
        for entry in in_tick_order(reader):
            findings.take(entry)
        findings.finish()
    except (LookupError, ValueError, TypeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    if findings.begin_ns is None:
        raise SourceError(f"{path}: holds no message")
    findings.whole, findings.damaged = reader.whole, reader.damaged
    findings.gaps, findings.provenance = reader.gaps(), reader.provenance
    return findings
