"""Contents of a recording as columns, collected in one pass over its entries."""

import math
from collections.abc import Sequence
from operator import sub
from typing import NamedTuple

from display_node.control.scene import SafetyScene
from protocol.summary.fields import Summary, read_summary
from protocol.wire.telemetry import PlaybackStatus
from telepulse.columns import UNKNOWN_NS, Rows, SessionColumns, TickRow
from telepulse.recording.mcap_reader import RecordingReader, in_tick_order, reading
from telepulse.telemetry.decoder import Entry, Fields, PassiveReceiver
from telepulse.telemetry.schema import EVENT, STATUS, TICK

# Values over time, in the units of their names; counts are those since the last status.
COUNTS = ("late", "lost", "misses")
LATENESS = ("late_p99_us", "late_max_us")
CLOCK = ("offset_ms", "uncertainty_ms", "skew_ppm")
ROUND_TRIP, ONE_WAY, PLAYOUT = "round_trip_ms", "one_way_ms", "playout_ms"


class Point(NamedTuple):
    """A value at a Unix time."""

    unix_ns: int
    value: float


class RecordedEvent(NamedTuple):
    """An event: Unix time, level as telemetry has it, name, text; session: its number, if any."""

    unix_ns: int
    level: int
    name: str
    text: str
    session: int | None


class RecordingContents:
    """Collector of the entries of a recording, in the order of `in_tick_order`.

    Another session begins with each session of the sensing node, where its clock jumps, and with
    another run of the display: times, samples and contactors before and after are unrelated.

    sessions: at least one. streams: name of the stream of each session of the sensing node.
    points: values over time, by name. receiver: the display's, after the last entry. summary: that
    of the last status, if any; final: it was the display's last one. begin_ns, end_ns: Unix time of
    the first entry, and the latest. gaps, provenance, about: see `RecordingReader`.
    """

    def __init__(self) -> None:
        self.sessions = [SessionColumns()]
        self.streams: list[str] = []
        names = (*COUNTS, *LATENESS, *CLOCK, ROUND_TRIP, ONE_WAY, PLAYOUT)
        self.points = {name: Rows(Point) for name in names}
        self.events: list[RecordedEvent] = []
        self.summary: Summary | None = None
        self.final = False
        self.begin_ns: int | None = None
        self.end_ns = 0
        self.gaps: list[str] = []
        self.provenance: list[dict[str, str]] = []
        self.about: dict[str, str] = {}
        self._entries = PassiveReceiver()
        self.receiver = self._entries.receiver
        self._resets = 0
        # The stream's session and the clock steps, with the first offset of both.
        self._steps: tuple[int, int | None] | None = None
        self._offset_ms = 0.0
        # The default applies until the display's first status.
        self._stale_after_ns = SafetyScene().stale_after_ns

    def take(self, entry: Entry) -> None:
        """Take an entry. Raises what `reading` expects for fields that are not those of one."""
        topic, unix_ns, fields = entry
        if self.begin_ns is None:
            self.begin_ns = unix_ns
        self.end_ns = max(self.end_ns, unix_ns)
        if topic == TICK:
            self._tick(unix_ns, fields)
        elif topic == EVENT:
            self._event(unix_ns, fields)
        elif topic == STATUS:
            self._status(unix_ns, fields)
        else:
            self._received(entry)

    def finish(self) -> None:
        """Let a session without a status be played as the one before it, else as the next."""
        playing: dict[str, PlaybackStatus] = {}
        for session in (*self.sessions, *reversed(self.sessions)):
            session.playing = playing = session.playing or playing

    def _begin(self) -> None:
        receiver = self.receiver
        self.sessions.append(SessionColumns(receiver.session or 0, receiver.description))

    def _tick(self, unix_ns: int, fields: Fields) -> None:
        now_ns, instant_ns, receiver = fields["now_ns"], fields["instant_ns"], self.receiver
        ready, target_n = receiver.ready, float(fields["target_n"])
        known_clock = ready or receiver.clock.ready
        sensing_ns = receiver.clock.remote_ns(now_ns) if known_clock else UNKNOWN_NS
        sampled_ns = self._entries.sampled_ns(instant_ns)
        live = ready and receiver.live(sampled_ns, sensing_ns, self._stale_after_ns)
        self._entries.play(instant_ns, trusted=live and fields.get("trusted", False))
        tick = TickRow(
            now_ns,
            sensing_ns,
            instant_ns,
            ready=ready,
            playing=ready and target_n != 0,
            full=fields["scored"],
            predicted=target_n != 0 and not any(receiver.buffer.known(1, 1, sampled_ns, [0])),
            unix_ns=unix_ns,
            press_n=fields.get("press_n", math.nan),
        )
        states = (fields, *fields.get("others", ()))
        forces_n = [
            [each.get(name, math.nan) for name in ("target_n", "felt_n")] for each in states
        ]
        self.sessions[-1].add_tick(tick, forces_n)
        if live and tick.playing:
            self._add(unix_ns, [PLAYOUT], (sensing_ns - instant_ns) * 1e-6)

    def _event(self, unix_ns: int, fields: Fields) -> None:
        name, text = fields["name"], fields["message"]
        if name == "begin":
            self._begin()
        level = fields["level"]
        if (type(level), type(name), type(text)) != (int, str, str):
            raise TypeError("an event's level is no number, or its name or text is no text")
        self.events.append(RecordedEvent(unix_ns, level, name, text, self.receiver.session))

    def _status(self, unix_ns: int, fields: Fields) -> None:
        before, new = self.summary or Summary(), read_summary(fields["summary"])
        self.summary, self.final = new, fields["final"]
        if fields.get("playing"):
            playing = [PlaybackStatus(**each) for each in fields["playing"]]
            self.sessions[-1].playing = {each.contactor: each for each in playing}
            self._stale_after_ns = playing[0].stale_after_ns
        counts, earlier = (
            (each.samples.late or 0, each.samples.lost or 0, each.loop.deadline_misses or 0)
            for each in (new, before)
        )
        self._add(unix_ns, COUNTS, *map(sub, counts, earlier))
        self._add(unix_ns, LATENESS, new.loop.late_us.p99, new.loop.late_us.max)
        clock, steps = new.clock, (self.receiver.sessions, new.clock.steps)
        if clock.offset_ms is not None:
            if steps != self._steps:
                # Offsets are not comparable across sessions and clock steps.
                self._steps, self._offset_ms = steps, clock.offset_ms
            offset_ms = clock.offset_ms - self._offset_ms
            self._add(unix_ns, CLOCK, offset_ms, clock.uncertainty_ms, clock.skew_ppm)

    def _received(self, entry: Entry) -> None:
        receiver, unix_ns, fields = self.receiver, entry.t_ns, entry.fields
        sessions, frame = receiver.sessions, self._entries.take(entry.topic, fields)
        self._add(unix_ns, [ROUND_TRIP], fields.get(ROUND_TRIP))
        if receiver.resets != self._resets:
            self._resets = receiver.resets
            self._begin()
        if receiver.description is not None and receiver.sessions != sessions:
            self.streams.append(receiver.description.name)
        if frame is not None:
            sensing_ns = receiver.clock.remote_ns(fields["arrived_ns"])
            last_ns = frame.t_first_ns + (len(frame.values) - 1) * frame.period_ns
            self._add(unix_ns, [ONE_WAY], (sensing_ns - last_ns) * 1e-6)
            self.sessions[-1].add_frame(frame, unix_ns - sensing_ns)

    def _add(self, unix_ns: int, names: Sequence[str], *values: float | None) -> None:
        for name, value in zip(names, values, strict=True):
            if value is not None:
                self.points[name].add(Point(unix_ns, value))


def read_contents(reader: RecordingReader) -> RecordingContents:
    """Read a recording to its end, also one that was cut short. Raises SourceError."""
    contents = RecordingContents()
    with reading(reader.path):
        for entry in in_tick_order(reader):
            contents.take(entry)
    contents.finish()
    contents.gaps, contents.about = reader.gaps(), reader.about
    contents.provenance = reader.provenance
    return contents
