"""State of a display over the last minutes: telemetry in rolling tables, thinned to curves. Pure.

All times are Unix time by the display's clock. Samples of the wrist are mapped to it by the clock
offset of the last status.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.reception.receiver import FUTURE_NS, OLDEST_NS
from display_node.scoring.beats import BeatAnalysis
from protocol.wire.messages import ChannelSamples, channel_samples
from telepulse.telemetry.decoder import Entry, Fields
from telepulse.telemetry.schema import EVENT, FRAME, STATUS, STREAM, TICK

Times = NDArray[np.int64]
Floats = NDArray[np.float64]
# A thinned curve is interrupted where at least this many consecutive buckets would be empty.
EMPTY_BUCKETS = 3


class TableSlice(NamedTuple):
    """Rows in order of time; first: number of earlier rows, dropped ones included.

    values: shape (rows, columns).
    """

    first: int
    t_ns: Times
    values: Floats


class RollingTable:
    """Table of the newest rows: at least `capacity` of them, at most twice as many."""

    def __init__(self, columns: int, capacity: int) -> None:
        self._capacity = capacity
        self._t_ns = np.empty(2 * capacity, np.int64)
        self._values = np.empty((2 * capacity, columns))
        self._end = self._dropped = 0

    def __len__(self) -> int:
        return self._end

    def add(self, t_ns: int, *values: float) -> None:
        """Add a row that is newer than those before."""
        self._make_room(1)
        self._t_ns[self._end] = t_ns
        self._values[self._end] = values
        self._end += 1

    def insert(self, t_ns: Times, values: Floats) -> None:
        """Add rows in order of time, shape (rows, columns), also between older ones."""
        count = len(t_ns)
        self._make_room(count)
        at = int(np.searchsorted(self._t_ns[: self._end], t_ns[0]))
        begin, self._end = self._end, self._end + count
        self._t_ns[begin : self._end] = t_ns
        self._values[begin : self._end] = values
        if at < begin:
            tail = slice(at, self._end)
            order = np.argsort(self._t_ns[tail], kind="stable")
            self._t_ns[tail] = self._t_ns[tail][order]
            self._values[tail] = self._values[tail][order]

    def has(self, t_ns: int, within_ns: int) -> bool:
        """Return whether there is a row within `within_ns` of a time."""
        at = int(np.searchsorted(self._t_ns[: self._end], t_ns - within_ns))
        return at < self._end and int(self._t_ns[at]) <= t_ns + within_ns

    def since(self, t_ns: int) -> TableSlice:
        """Return the rows from a time on, as views that hold until the next row is added."""
        at = int(np.searchsorted(self._t_ns[: self._end], t_ns))
        first = self._dropped + at
        return TableSlice(first, self._t_ns[at : self._end], self._values[at : self._end])

    def _make_room(self, count: int) -> None:
        if count > self._capacity:
            raise ValueError(f"{count} rows at once; there is room for {self._capacity}")
        if self._end + count <= len(self._t_ns):
            return
        drop = self._end - (self._capacity - count)
        kept = slice(drop, self._end)
        self._dropped += drop
        self._end -= drop
        self._t_ns[: self._end] = self._t_ns[kept].copy()
        self._values[: self._end] = self._values[kept].copy()


def thin(first: int, t_ns: Times, values: Floats, points: int, gap_ns: int) -> tuple[Times, Floats]:
    """Return a curve of about `points` points at most: least and greatest value of each bucket.

    `first` keeps the buckets the same from call to call, so a curve keeps its shape while it
    moves. A gap longer than `gap_ns` gets a NaN, which breaks the line.
    """
    stride = 1
    while len(values) > stride * points // 2:
        stride *= 2
    if stride > 2:
        skip = -first % stride
        count = (len(values) - skip) // stride
        buckets = values[skip : skip + count * stride].reshape(count, stride)
        low = np.argmin(np.where(np.isnan(buckets), np.inf, buckets), axis=1)
        high = np.argmax(np.where(np.isnan(buckets), -np.inf, buckets), axis=1)
        pairs = np.sort(np.column_stack([low, high]), axis=1)
        at = (skip + stride * np.arange(count)[:, np.newaxis] + pairs).ravel()
        # The newest row, too, which may be in no whole bucket yet.
        at = np.append(at, len(values) - 1)
        typical_ns = int(np.median(np.diff(t_ns)))
        gap_ns = max(gap_ns, EMPTY_BUCKETS * stride * typical_ns)
        t_ns, values = t_ns[at], values[at]
    breaks = np.flatnonzero(np.diff(t_ns) > gap_ns) + 1
    return np.insert(t_ns, breaks, t_ns[breaks]), np.insert(values, breaks, np.nan)


MS = 1_000_000
# Rows of the tables of ticks and samples, 65 s at 1 kHz, and of the table of statuses.
FAST_ROWS, SLOW_ROWS = 1 << 16, 1 << 11
EVENTS = 12
# Shares of lost and late samples are taken over this many statuses: one second.
LOSS_STATUSES = 5


class LiveState:
    """State of one run of a display; another run resets it.

    Columns of ticks: felt_n (NaN where unknown), playout delay in ns (NaN where the pulse is not
    felt at full strength), predictor_error_n (NaN without one). wrist: force in N of samples.
    beats: at the onset of each, force at the foot and height in N, and quality (NaN where unknown).
    delays: one-way delay in ms of frames. statuses: clock offset and its uncertainty in ms, skew in
    ppm, samples lost and late in %; then, since the run's start: refused messages, seconds at any
    limit.

    trusted: whether the predictor was trusted at the last tick.
    playing: the signal that is played, as in the last status; empty before. stream_ended: the
    sensing node has ended the stream. display_ended: the display has sent its final status.
    stepped_ns, telemetry_missed_ns: Unix time of the last clock step, and of the last telemetry
    that was missed; −∞ before any.
    """

    def __init__(self) -> None:
        takers = (self._tick, self._frame, self._status, self._stream, self._event)
        self._take = dict(zip((TICK, FRAME, STATUS, STREAM, EVENT), takers, strict=True))
        self.events: deque[tuple[int, int, str]] = deque(maxlen=EVENTS)
        self._begin()

    def _begin(self) -> None:
        self.ticks = RollingTable(3, FAST_ROWS)
        self.wrist = RollingTable(1, FAST_ROWS)
        self.beats = RollingTable(3, SLOW_ROWS)
        self._analysis = BeatAnalysis()
        self.delays = RollingTable(1, FAST_ROWS)
        self.statuses = RollingTable(7, SLOW_ROWS)
        self._samples: deque[Fields] = deque(maxlen=LOSS_STATUSES)
        self._offset_ns: int | None = None
        self._group_delay_ns = 0
        self.trusted = False
        self.playing: Fields = {}
        self._session: int | None = None
        self.now_ns = self.frame_ns = 0
        self.stepped_ns = self.telemetry_missed_ns = -math.inf
        self.state, self.stream = "", ""
        self.summary: Fields = {}
        self.stream_ended = self.display_ended = False

    def take(self, entry: Entry) -> None:
        """Process a message of the display, or an event."""
        if take := self._take.get(entry.topic):
            take(entry)

    def _tick(self, entry: Entry) -> None:
        fields = entry.fields
        if entry.t_ns < self.now_ns:
            return
        self.now_ns = entry.t_ns
        delay_ns = math.nan
        if fields["scored"] and self._offset_ns is not None:
            delay_ns = fields["now_ns"] + self._offset_ns - fields["instant_ns"]
        self.trusted = bool(fields.get("trusted"))
        felt_n, error_n = (fields.get(key, math.nan) for key in ("felt_n", "predictor_error_n"))
        self.ticks.add(entry.t_ns, felt_n, delay_ns, error_n)

    def _frame(self, entry: Entry) -> None:
        fields, offset_ns = entry.fields, self._offset_ns
        if fields["session"] != self._session:
            return
        self.frame_ns, self.stream_ended = entry.t_ns, False
        if offset_ns is None or not self.playing:
            return
        values = fields["force_n"][self.playing["channel"] :: fields["channels"]]
        if not values:
            return
        unix_ns, period_ns = entry.t_ns - fields["arrived_ns"], fields["period_ns"]
        sampled_ns = fields["t_first_ns"] - offset_ns + unix_ns
        one_way_ns = entry.t_ns - sampled_ns - (len(values) - 1) * period_ns
        # The display refuses frames that are further off.
        if not -FUTURE_NS < one_way_ns < OLDEST_NS:
            return
        self.delays.add(entry.t_ns, one_way_ns / MS)
        t_ns = sampled_ns - self._group_delay_ns + period_ns * np.arange(len(values))
        # Copies over other paths are skipped.
        if not self.wrist.has(int(t_ns[0]), period_ns // 2):
            self.wrist.insert(t_ns, np.array(values)[:, np.newaxis])
            samples = channel_samples(0, fields["t_first_ns"], period_ns, values)
            self._add_beats(samples, int(t_ns[0]))

    def _add_beats(self, samples: ChannelSamples, unix_ns: int) -> None:
        """Add the beats that a frame completes; unix_ns: Unix time of its first sample."""
        for beat in self._analysis.observe(samples):
            quality = math.nan if beat.quality is None else beat.quality
            t_ns = beat.onset_ns - samples.times_ns[0] + unix_ns
            self.beats.add(t_ns, beat.foot_n, beat.height_n, quality)

    def _status(self, entry: Entry) -> None:
        fields = entry.fields
        self.state, self.stream = fields["state"], fields["stream"]
        self.display_ended, self.summary = fields["final"], fields["summary"]
        clock = self.summary["clock"]
        if "offset_ms" in clock:
            self._offset_ns = round(clock["offset_ms"] * MS)
        self.playing = fields.get("playing", [self.playing])[0]
        self._samples.append(self.summary["samples"])
        self.statuses.add(
            max(self.now_ns, entry.t_ns),
            *(clock.get(name, math.nan) for name in ("offset_ms", "uncertainty_ms", "skew_ppm")),
            *self._shares(),
            sum(self.summary["rejected"].values()),
            sum(limit.get("seconds", 0.0) for limit in self.summary["limited"].values()),
        )

    def _shares(self) -> tuple[float, float]:
        """Return the percentages lost and late of the samples due in the last second."""
        old, new = self._samples[0], self._samples[-1]
        names = ("played", "predicted", "lost", "late")
        grown = {name: new.get(name, 0) - old.get(name, 0) for name in names}
        due = sum(grown.values())
        if due <= 0:
            return math.nan, math.nan
        # A lost sample that arrives after all becomes a predicted or a late one.
        return max(0.0, 100 * grown["lost"] / due), max(0.0, 100 * grown["late"] / due)

    def _stream(self, entry: Entry) -> None:
        fields = entry.fields
        if fields["session"] != self._session:
            self._analysis = BeatAnalysis()
        self._session, self.stream_ended = fields["session"], False
        self._group_delay_ns = fields["group_delay_ns"]

    def _event(self, entry: Entry) -> None:
        name = entry.fields["name"]
        if name == "begin":
            self._begin()
        elif name == "end of stream":
            self.stream_ended = True
        elif name == "clock step":
            self.stepped_ns = entry.t_ns
        elif name == "missed":
            self.telemetry_missed_ns = entry.t_ns
        # The texts are those of recordings.
        text = entry.fields["message"]
        text = text.replace("the recorder", "this page").replace("the recording", "this page")
        self.events.append((entry.t_ns, entry.fields["level"], f"{name}: {text}"))
