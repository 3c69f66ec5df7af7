"""Findings about a recording, gathered in one pass and in bounded memory."""

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter

from display_node.control.scene import SafetyScene
from display_node.scoring.tracking_error import scored
from protocol.errors import SourceError
from protocol.histogram import Histogram
from protocol.summary.tables import Availability, Loop, PlayoutDelay, Summary, with_contactors
from telepulse.recording.forces import ContactorFindings, Trend
from telepulse.recording.pressed_beats import PressedBeats
from telepulse.recording.reader import RecordingReader, in_tick_order
from telepulse.telemetry.decoder import Entry, PassiveReceiver
from telepulse.telemetry.schema import EVENT, STATUS, STREAM, TICK

MAX_EVENTS = 500
# Most entries of a session that wait for its first status: 10 s of ticks at 1 kHz, with frames.
MAX_EARLY = 20_000
# Values are added to a trend in batches of this size.
BATCH = 1_000
COUNTS, COUNT_WIDTH_S = ("late", "lost", "misses"), 1.0
_SUMMARY = TypeAdapter(Summary)


class RecordedEvent(NamedTuple):
    """An event: time in s since the recording's start, level as telemetry has it, name, text."""

    t_s: float
    level: int
    name: str
    text: str


class RunFindings:
    """Findings about a recording, complete after `finish`.

    Attributes
    ----------
    gaps, provenance, about
        See `RecordingReader`.
    display_summary : Summary or None
        The summary in the display's last recorded status.
    is_final_summary : bool
        True if that status was the display's final one.
    trends : dict of Trend
        Values over the time of the recording, in the units of their names.
    contactors : list of ContactorFindings
        Forces and beats of each contactor, in the order in which the display named them.
    depth : PressedBeats
        Beats of a wrist that was pressed, by their hold-down.
    events : list of RecordedEvent
        The first events, in the order of their times; `more_events` counts the others.
    """

    def __init__(self) -> None:
        self.gaps: list[str] = []
        self.provenance: list[dict[str, str]] = []
        self.about: dict[str, str] = {}
        self.begin_ns: int | None = None
        self.end_ns = self.ticks = self.runs = self.more_events = 0
        self.streams: list[str] = []
        self.display_summary: Summary | None = None
        self.is_final_summary = False
        counts = {name: Trend(COUNT_WIDTH_S) for name in COUNTS}
        self.trends: defaultdict[str, Trend] = defaultdict(Trend, counts)
        self.contactors = [ContactorFindings()]
        # Those of the display's last status, in its order.
        self._playing = self.contactors[:]
        self.events: list[RecordedEvent] = []
        self.playout_ms = Histogram(0.5, 8_000)
        self._entries = PassiveReceiver()
        self._receiver = self._entries.receiver
        self.one_way_delay_ms = self._receiver.one_way_delay_ms
        self._session: int | None = None
        self._offset_ms = 0.0
        self._steps: tuple[int | None, int | None] = (None, None)
        self._misses = self._scored = self._played = self._tick_ns = 0
        # The default applies until the display's first status.
        self._stale_after_ns = SafetyScene().stale_after_ns
        self._last_now_ns: int | None = None
        # Entries of a session before the status that names the channel of each contactor.
        self._early: list[tuple[float, Entry]] | None = []
        self._batch: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
        self.depth = PressedBeats()

    @property
    def seconds(self) -> float:
        """Length in s."""
        return 0.0 if self.begin_ns is None else (self.end_ns - self.begin_ns) * 1e-9

    def summary(self) -> Summary:
        """Return those figures of a display's summary that the recording determines."""
        delay, ticks, availability = self.playout_ms, self.ticks + self._misses, Availability()
        if ticks:
            counts = (self._scored, self._misses, self._played)
            felt, missed, played = (count / ticks for count in counts)
            seconds = ticks * self._tick_ns * 1e-9
            # Only the display counts the other shares.
            availability = Availability(seconds, felt, missed=missed, played=played)
        summary = replace(
            self._receiver.summary(self._last_now_ns or 0),
            playout_delay_ms=PlayoutDelay(delay.mean, **delay.quantiles(p99=0.99)),
            availability=availability,
            loop=Loop(self.ticks, self._misses),
        )
        figures = {each.name: Summary(beats=each.beats.figures()) for each in self.contactors}
        whole = with_contactors(summary, figures)
        errors = [each.forces.alignment.errors for each in self.contactors]
        return whole if self.pressed else scored(whole, errors)

    @property
    def pressed(self) -> bool:
        """True where a finger or a sweep pressed: the felt force is not that of the wrist alone."""
        return self.display_summary is not None and self.display_summary.press.press_n is not None

    def take(self, entry: Entry) -> None:
        """Process a message of the recording, in the order of `in_tick_order`."""
        if self.begin_ns is None:
            self.begin_ns = entry.t_ns
        self.end_ns = max(self.end_ns, entry.t_ns)
        t_s = (entry.t_ns - self.begin_ns) * 1e-9
        if entry.topic == EVENT:
            self._event(t_s, entry.fields)
        elif entry.topic == STATUS:
            self._status(t_s, entry.fields)
        else:
            if entry.topic == STREAM and self._early is None:
                self._early = []
            if self._early is None:
                self._take_in_session(t_s, entry)
            else:
                self._early.append((t_s, entry))
                if len(self._early) > MAX_EARLY:
                    self._take_early()

    def finish(self) -> None:
        """End the recording."""
        self._take_early()
        # An event may be recorded after those that followed it.
        self.events.sort(key=lambda event: event.t_s)
        for contactor in self.contactors:
            contactor.forces.alignment.finish()
        self.depth.finish()
        for name in list(self._batch):
            self._flush(name)

    def _take_early(self) -> None:
        early, self._early = self._early or [], None
        for t_s, entry in early:
            self._take_in_session(t_s, entry)

    def _take_in_session(self, t_s: float, entry: Entry) -> None:
        if entry.topic == TICK:
            self._tick(t_s, entry.fields)
        else:
            self._received(t_s, entry)

    def _received(self, t_s: float, entry: Entry) -> None:
        receiver, fields = self._receiver, entry.fields
        frame, description = self._entries.take(entry.topic, fields), receiver.description
        self._add("round_trip_ms", t_s, fields.get("round_trip_ms"))
        if description is not None and receiver.session != self._session:
            self._session = receiver.session
            self.streams.append(description.name)
            for contactor in self.contactors:
                contactor.begin()
            self.depth.begin()
        if description is not None and frame is not None:
            last_ns = frame.t_first_ns + (len(frame.values) - 1) * frame.period_ns
            one_way_ns = receiver.clock.remote_ns(fields["arrived_ns"]) - last_ns
            self._add("one_way_ms", t_s, one_way_ns * 1e-6)
            for contactor in self.contactors:
                contactor.add_frame(frame, description, t_s - one_way_ns * 1e-9, last_ns)
            channel = self.contactors[0].forces.alignment.channel
            hold_down_n = self.depth.take(frame, description, channel, fields["arrived_ns"])
            self._add("wrist_hold_down_n", t_s - one_way_ns * 1e-9, hold_down_n)

    def _tick(self, t_s: float, fields: dict[str, Any]) -> None:
        now_ns, instant_ns, receiver = fields["now_ns"], fields["instant_ns"], self._receiver
        self.ticks += 1
        self._add("press_n", t_s, fields.get("press_n"))
        self._count_misses(now_ns)
        if not receiver.ready:
            return
        sensing_now_ns, target_n = receiver.clock.remote_ns(now_ns), float(fields["target_n"])
        sampled_ns = self._entries.sampled_ns(instant_ns)
        alive = receiver.live(sampled_ns, sensing_now_ns, self._stale_after_ns)
        self._entries.play(instant_ns, trusted=alive and fields.get("trusted", False))
        if target_n and alive:
            self._played += 1
            delay_ms = (sensing_now_ns - instant_ns) * 1e-6
            self.playout_ms.add(delay_ms)
            self._add("playout_ms", t_s, delay_ms)
        if fields["scored"]:
            self._scored += 1
            states = (fields, *fields.get("others", ()))
            # Without a status, only the first contactor is known.
            for contactor, state in zip(self._playing, states, strict=False):
                contactor.add_tick(t_s, sensing_now_ns, instant_ns, state)

    def _count_misses(self, now_ns: int) -> None:
        """Count missed ticks: multiples of the period at which no tick is recorded."""
        last_ns, self._last_now_ns = self._last_now_ns, now_ns
        if last_ns is None or now_ns <= last_ns:
            return
        apart_ns = now_ns - last_ns
        self._tick_ns = min(self._tick_ns, apart_ns) if self._tick_ns else apart_ns
        self._misses += round(apart_ns / self._tick_ns) - 1

    def _status(self, t_s: float, fields: dict[str, Any]) -> None:
        new, playing = _SUMMARY.validate_python(fields["summary"]), fields.get("playing")
        if playing:
            self._stale_after_ns = int(playing[0]["stale_after_ns"])
            self._playing = [self._follow(each) for each in playing]
            self._take_early()
        last = self.display_summary or Summary()
        self.display_summary, self.is_final_summary = new, fields["final"]
        before, now = (
            (each.samples.late or 0, each.samples.lost or 0, each.loop.deadline_misses or 0)
            for each in (last, new)
        )
        for name, count, earlier in zip(COUNTS, now, before, strict=True):
            self._add(name, t_s, count - earlier)
        self._add("late_p99_us", t_s, new.loop.late_us.p99)
        self._add("late_max_us", t_s, new.loop.late_us.max)
        clock = new.clock
        if clock.offset_ms is not None:
            if (self._session, clock.steps) != self._steps:
                # Offsets are not comparable across sessions and clock steps.
                self._steps, self._offset_ms = (self._session, clock.steps), clock.offset_ms
            self._add("offset_ms", t_s, clock.offset_ms - self._offset_ms)
            self._add("uncertainty_ms", t_s, clock.uncertainty_ms)
            self._add("skew_ppm", t_s, clock.skew_ppm)

    def _follow(self, playing: dict[str, Any]) -> ContactorFindings:
        """Return the contactor that a status names; a further run's display may have others."""
        name = str(playing["contactor"])
        known = (each for each in self.contactors if each.name in ("", name))
        contactor = next(known, None)
        if contactor is None:
            self.contactors.append(contactor := ContactorFindings())
        contactor.name = name
        contactor.set_playback(playing)
        return contactor

    def _event(self, t_s: float, fields: dict[str, Any]) -> None:
        self.runs += fields["name"] == "begin"
        if len(self.events) < MAX_EVENTS:
            self.events.append(
                RecordedEvent(t_s, fields["level"], fields["name"], fields["message"])
            )
        else:
            self.more_events += 1

    def _add(self, name: str, t_s: float, value: float | None) -> None:
        if value is not None:
            self._batch[name].append((t_s, value))
            if len(self._batch[name]) >= BATCH:
                self._flush(name)

    def _flush(self, name: str) -> None:
        t_s, values = np.array(self._batch.pop(name), float).T
        self.trends[name].add(t_s, values)


def read_findings(path: Path) -> RunFindings:
    """Read a recording to its end, also one that was cut short. Raises SourceError."""
    reader, findings = RecordingReader(path), RunFindings()
    try:
        for entry in in_tick_order(reader):
            findings.take(entry)
        findings.finish()
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    if findings.begin_ns is None:
        raise SourceError(f"{path}: holds no message")
    findings.gaps, findings.provenance = reader.gaps(), reader.provenance
    findings.about = reader.about
    return findings
