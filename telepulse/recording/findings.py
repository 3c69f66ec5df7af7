"""Findings about a recording, computed from its contents."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.tracking_error import Floats
from protocol.errors import SourceError
from protocol.histogram import Histogram
from protocol.summary.fields import Availability, Loop, PlayoutDelay, Summary, with_contactors
from protocol.wire.description import HOLD_DOWN
from telepulse.columns import SessionColumns, join_ticks
from telepulse.recording.contents import COUNTS, PLAYOUT, RecordingContents, read_contents
from telepulse.recording.forces import NARROWEST_S, ContactorFindings, find_trend
from telepulse.recording.mcap_reader import RecordingReader, reading
from telepulse.recording.pressed_beats import SteadyBeat, find_steady_beats

MAX_EVENTS = 500
COUNT_WIDTH_S = 1.0
# Name of the trend of the hold-down.
HELD = "wrist_hold_down_n"


class RunFindings:
    """Findings about a recording.

    Attributes
    ----------
    contents : RecordingContents
        The contents that they were computed from.
    trends : dict of str to Trend
        Values over the time of the recording, in the units of their names.
    contactors : list of ContactorFindings
        Forces and beats of each contactor, in the order in which the display named them.
    steady_beats : list of SteadyBeat
        Beats of a wrist that was pressed, at a steady hold-down.
    events : list of RecordedEvent
        The first events, in the order of their times; `more_events` counts the others.
    ticks, misses : int
        Number of recorded ticks, and of those that are missing between them.
    """

    def __init__(self, contents: RecordingContents) -> None:
        self.contents, sessions = contents, contents.sessions
        begin_ns = self._begin_ns = contents.begin_ns or 0
        # An event may be recorded after those that followed it.
        self.events = sorted(contents.events[:MAX_EVENTS], key=lambda event: event.unix_ns)
        self.more_events = max(0, len(contents.events) - MAX_EVENTS)
        self.runs = sum(event.name == "begin" for event in contents.events)
        names = dict.fromkeys(chain.from_iterable(session.playing for session in sessions))
        self.contactors = [ContactorFindings(name, sessions, begin_ns) for name in names or [""]]
        self.trends = {
            name: find_trend(
                self.times_s(points["unix_ns"]),
                points["value"],
                COUNT_WIDTH_S if name in COUNTS else NARROWEST_S,
            )
            for name, points in contents.points.items()
        }
        now_ns, unix_ns, press_n = (
            join_ticks(sessions, column) for column in ("now_ns", "unix_ns", "press_n")
        )
        self.trends["press_n"] = find_trend(self.times_s(unix_ns), press_n)
        self.steady_beats: list[SteadyBeat] = []
        held_s, held_n = zip(*map(self._hold_down, sessions), strict=True)
        self.trends[HELD] = find_trend(np.concatenate(held_s), np.concatenate(held_n))
        self.playout_ms = Histogram(0.5, 8_000)
        for delay_ms in contents.points[PLAYOUT]["value"].tolist():
            self.playout_ms.add(delay_ms)
        # Ticks are missed where their distance is a multiple of the shortest one so far.
        apart_ns = np.diff(now_ns)
        apart_ns = apart_ns[apart_ns > 0]
        shortest_ns = np.minimum.accumulate(apart_ns)
        self.ticks, self.misses = len(now_ns), int((np.rint(apart_ns / shortest_ns) - 1).sum())
        self._last_now_ns = int(now_ns[-1]) if self.ticks else 0
        self._tick_ns = int(shortest_ns[-1]) if len(apart_ns) else 0

    @property
    def seconds(self) -> float:
        """Length in s."""
        return max(0, self.contents.end_ns - self._begin_ns) * 1e-9

    @property
    def pressed(self) -> bool:
        """True where a finger or a sweep pressed: the felt force is not that of the wrist alone."""
        summary = self.contents.summary
        return summary is not None and summary.press.press_n is not None

    def summary(self) -> Summary:
        """Return those figures of a display's summary that the recording determines."""
        delay, ticks, sessions = self.playout_ms, self.ticks + self.misses, self.contents.sessions
        availability = Availability()
        if ticks:
            full, ready = (join_ticks(sessions, column) for column in ("full", "ready"))
            counts = (int((full & ready).sum()), self.misses, delay.count)
            felt, missed, played = (count / ticks for count in counts)
            seconds = ticks * self._tick_ns * 1e-9
            # Only the display counts the other shares.
            availability = Availability(seconds, felt, missed=missed, played=played)
        loop = Loop(self.ticks, self.misses)
        summary = replace(
            self.contents.receiver.summary(self._last_now_ns),
            playout_delay_ms=PlayoutDelay(delay.mean, **delay.quantiles(p99=0.99)),
            availability=availability,
            loop=loop,
        )
        figures = dict[str, Summary]()
        for each in self.contactors:
            own = Summary(beats=each.beats.figures(None if self.pressed else each.ratio))
            figures[each.name] = own if self.pressed else each.errors.add_to(own, loop)
        return with_contactors(summary, figures)

    def times_s(self, unix_ns: NDArray[np.int64] | Sequence[int]) -> Floats:
        """Return Unix times as times in s since the recording's start."""
        return np.asarray((np.asarray(unix_ns, np.int64) - self._begin_ns) * 1e-9)

    def _hold_down(self, session: SessionColumns) -> tuple[Floats, Floats]:
        """Return time and mean hold-down of the frames of a stream that has one; add its beats."""
        channels = () if session.description is None else session.description.channels
        cell = next((n for n, each in enumerate(channels) if each.name == HOLD_DOWN), None)
        if cell is None or not len(session.frames):
            return np.empty(0), np.empty(0)
        pulse = next((each.channel for each in session.playing.values()), 0)
        frames = sorted(session.each_frame(), key=lambda frame: frame.first_sample)
        self.steady_beats += find_steady_beats(frames, pulse, cell)
        first_ns, period_ns, samples, ahead_ns = (
            session.frames[name] for name in ("t_first_ns", "period_ns", "samples", "unix_ahead_ns")
        )
        values = session.values.astype(np.float64)
        total_n = np.add.reduceat(values[:, cell] - values[:, pulse], np.cumsum(samples) - samples)
        return self.times_s(first_ns + (samples - 1) * period_ns + ahead_ns), total_n / samples


def read_findings(path: Path) -> RunFindings:
    """Read a recording to its end, also one that was cut short, which is logged.

    Raises SourceError.
    """
    reader = RecordingReader(path)
    contents = read_contents(reader)
    reader.log_gaps()
    if contents.begin_ns is None:
        raise SourceError(f"{path}: holds no message")
    with reading(path):
        return RunFindings(contents)
