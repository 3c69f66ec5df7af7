"""The regular grid of 5 ms on which the pulse is predicted, and the rhythm on it.

A cell's value is the mean over 5 ms of the piecewise-linear curve through the samples. At high
rates this averages noise and aliasing; at low rates, and over short gaps, it interpolates.
"""

import math
import statistics
from bisect import bisect_left, bisect_right
from collections import deque
from typing import NamedTuple

STEP_NS = 5_000_000
# Over a longer gap nothing is interpolated; the numbers of the cells continue without a gap.
MAX_GAP_NS = 100_000_000
KEEP_NS = 1_000_000_000


class GridCell(NamedTuple):
    """Cell of the grid.

    number: from 0. end_ns: time of its end. value: mean of the signal in it. ends, continues: the
    signal at its end and a cell later, which is continued linearly from the newest samples. newest:
    whether the samples that completed it completed no later one.
    """

    number: int
    end_ns: int
    value: float
    ends: float
    continues: float
    newest: bool


class Grid:
    """Means over cells of 5 ms of samples at any rate, in order or late.

    Attributes
    ----------
    new_cells
        Complete cells, which the reader removes.
    corrections
        Cells that late samples changed after their removal.
    """

    def __init__(self) -> None:
        self._times: list[int] = []
        self._values: list[float] = []
        self._first_ns = self._first_number = 0
        self._end_ns: int | None = None
        self._count = 0
        self.new_cells: deque[GridCell] = deque()
        self.corrections: list[GridCell] = []

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take new samples, in order of time. None may come twice, or between those of a call."""
        times = self._times
        if self._end_ns is None:
            self._begin(times_ns[-1])
        newest_ns = times[-1] if times else times_ns[0]
        if times_ns[0] < newest_ns:
            self._insert(times_ns, values)
            return
        if times_ns[0] - newest_ns > MAX_GAP_NS:
            times.clear()
            self._values.clear()
            self._begin(times_ns[0])
        times += times_ns
        self._values += values
        self._complete()
        if times[-1] - times[0] > 2 * KEEP_NS:
            old = bisect_left(times, times[-1] - KEEP_NS)
            del times[:old], self._values[:old]

    def _begin(self, end_ns: int) -> None:
        # Cells end with frames, so that a cell is complete when its frame arrives.
        self._first_ns = self._end_ns = end_ns
        self._first_number = self._count

    def _complete(self) -> None:
        """Add the cells that the newest sample completes to `new_cells`."""
        end_ns = (self._end_ns or 0) + STEP_NS
        newest_ns = self._times[-1]
        while end_ns <= newest_ns:
            newest = end_ns + STEP_NS > newest_ns
            self.new_cells.append(self._cell(self._count, end_ns, newest))
            self._end_ns = end_ns
            self._count += 1
            end_ns += STEP_NS

    def _insert(self, times_ns: list[int], values: list[float]) -> None:
        """Insert late samples and recompute the cells that were interpolated without them."""
        times, first_ns = self._times, self._first_ns
        if times_ns[0] < times[0]:
            return
        place = bisect_left(times, times_ns[0])
        times[place:place] = times_ns
        self._values[place:place] = values
        before, after = times[max(0, place - 1)], times[min(len(times) - 1, place + len(times_ns))]
        first = max(0, (before - first_ns) // STEP_NS)
        last = min(self._count - self._first_number - 1, (after - first_ns) // STEP_NS)
        for position in range(first, last + 1):
            end_ns = first_ns + (position + 1) * STEP_NS
            if end_ns - STEP_NS < times[0]:
                continue
            number = self._first_number + position
            waiting = len(self.new_cells) - (self._count - number)
            if waiting < 0:
                self.corrections.append(self._cell(number, end_ns, newest=False))
            else:
                newest = self.new_cells[waiting].newest
                self.new_cells[waiting] = self._cell(number, end_ns, newest)
        self._complete()

    def _cell(self, number: int, end_ns: int, newest: bool) -> GridCell:
        times, values, start_ns = self._times, self._values, end_ns - STEP_NS
        first = bisect_right(times, start_ns)
        last = bisect_left(times, end_ns, first)
        t_ns, value = start_ns, self._interpolate(first, start_ns)
        area = 0.0
        for place in range(first, last):
            next_ns, next_value = times[place], values[place]
            area += (next_ns - t_ns) * 0.5 * (value + next_value)
            t_ns, value = next_ns, next_value
        ends = self._interpolate(last, end_ns)
        area += (end_ns - t_ns) * 0.5 * (value + ends)
        after_ns, newest_ns = end_ns + STEP_NS, times[-1]
        if after_ns <= newest_ns:
            continues = self._interpolate(bisect_left(times, after_ns, last), after_ns)
        else:
            before_ns = newest_ns - STEP_NS
            before = self._interpolate(bisect_left(times, before_ns), before_ns)
            continues = values[-1] + (after_ns - newest_ns) / STEP_NS * (values[-1] - before)
        return GridCell(number, end_ns, area / STEP_NS, ends, continues, newest)

    def _interpolate(self, position: int, t_ns: int) -> float:
        """Return the value at a time between samples `position` − 1 and `position`."""
        times, values = self._times, self._values
        if not position or position == len(times):
            return values[position - 1 if position else 0]
        after_ns, after = times[position], values[position]
        before_ns, before = times[position - 1], values[position - 1]
        return before + (t_ns - before_ns) / (after_ns - before_ns) * (after - before)


# Number of the last beats that count, and the least number of them that is enough.
BEATS, FEWEST = 9, 2
SHARE = 0.45
# Least distance of two beats in steps: 250 ms.
REFRACTORY = 50
# Before peaks are known, the threshold follows the highest slope, which fades in 3 s. After as long
# without a beat the search begins again, since an artefact can raise the threshold too far.
FADE_STEPS = 600
FADE = 1 - 1 / FADE_STEPS


class Rhythm:
    """Detector of a signal's beats: the slope rises through a share of its usual peak.

    interval: median interval of the last beats in steps of the grid; None before enough beats.
    steps_ago: steps from the last beat to the newest slope.
    """

    def __init__(self) -> None:
        self._step = 0
        self._slope = 0.0
        self.steps_ago = math.inf
        self._begin()

    def _begin(self) -> None:
        self.interval: float | None = None
        self._intervals: list[int] = []
        self._peaks: list[float] = []
        self._peak = self._highest = 0.0
        self._threshold = math.inf
        self._beat_step: int | None = None

    def push(self, slope: float) -> None:
        """Take the slope at the next step."""
        self._step += 1
        rested = self._beat_step is None or self._step - self._beat_step > REFRACTORY
        self.steps_ago += 1
        if self._slope < self._threshold <= slope and rested:
            self.steps_ago = (slope - self._threshold) / (slope - self._slope)
            self._begin_beat()
        elif self._beat_step is not None and self._step - self._beat_step > FADE_STEPS:
            self._begin()
        self._slope = slope
        self._peak = max(self._peak, slope)
        self._highest = max(self._highest * FADE, slope)
        if self.interval is None and self._highest > 0:
            self._threshold = SHARE * self._highest

    def _begin_beat(self) -> None:
        if self._beat_step is not None:
            self._peaks = [*self._peaks[1 - BEATS :], self._peak]
            self._intervals = [*self._intervals[1 - BEATS :], self._step - self._beat_step]
            if len(self._peaks) >= FEWEST:
                # An upper quantile, as the peaks may be those of two waves in each beat.
                usual = sorted(self._peaks)[-1 - len(self._peaks) // 4]
                self._threshold = SHARE * usual
                self.interval = statistics.median(self._intervals)
        self._peak = 0.0
        self._beat_step = self._step
