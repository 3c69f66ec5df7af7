"""An expert of the stack, and the history that it predicts from.

`Grid` turns samples of any rate, in order or late, into means over cells of 5 ms; `History` holds
the newest of them; an `Expert` predicts from it over a common row of horizons.

A cell's mean is that of the samples joined by straight lines: at high rates it averages the
noise and what would alias, at low rates and over short gaps it interpolates.
"""

from bisect import bisect_left, bisect_right, insort
from collections import deque
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

STEP_NS = 5_000_000
# Further apart, nothing is known between two samples; the cells after them follow directly.
MAX_GAP_NS = 100_000_000
KEEP_NS = 1_000_000_000


class GridCell(NamedTuple):
    """A cell's number from 0, its end and its mean."""

    number: int
    end_ns: int
    value: float


class Grid:
    """Turns samples into cells. `fresh`: those not taken yet; `late`: corrections of older ones."""

    def __init__(self) -> None:
        self._samples: list[tuple[int, float]] = []
        self._first_ns = 0
        self._first_number = 0
        self._end_ns: int | None = None
        self._count = 0
        self.fresh: deque[GridCell] = deque()
        self.late: list[GridCell] = []

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take samples that have newly arrived, in order among themselves; none of them twice."""
        samples = self._samples
        if self._end_ns is None:
            self._begin(times_ns[-1])
        newest_ns = samples[-1][0] if samples else times_ns[0]
        if times_ns[0] < newest_ns:
            self._insert(times_ns, values)
            return
        if times_ns[0] - newest_ns > MAX_GAP_NS:
            samples.clear()
            self._begin(times_ns[0])
        samples.extend(zip(times_ns, values, strict=True))
        self._complete()
        if samples[-1][0] - samples[0][0] > 2 * KEEP_NS:
            del samples[: bisect_left(samples, (samples[-1][0] - KEEP_NS,))]

    def _begin(self, end_ns: int) -> None:
        # Cells end with a frame, so that the newest is complete as soon as its frame is here.
        self._first_ns = self._end_ns = end_ns
        self._first_number = self._count

    def _complete(self) -> None:
        """Give out the cells that the newest sample completes."""
        end_ns = (self._end_ns or 0) + STEP_NS
        while end_ns <= self._samples[-1][0]:
            self.fresh.append(GridCell(self._count, end_ns, self._mean(end_ns)))
            self._end_ns = end_ns
            self._count += 1
            end_ns += STEP_NS

    def _insert(self, times_ns: list[int], values: list[float]) -> None:
        """Put late samples in their place and correct the cells that had been guessed."""
        samples = self._samples
        if times_ns[0] < samples[0][0]:
            return
        for sample in zip(times_ns, values, strict=True):
            insort(samples, sample)
        before = samples[max(0, bisect_left(samples, (times_ns[0],)) - 1)][0]
        after = samples[min(len(samples) - 1, bisect_right(samples, (times_ns[-1] + 1,)))][0]
        first = max(0, (before - self._first_ns) // STEP_NS)
        last = min(self._count - self._first_number - 1, (after - self._first_ns) // STEP_NS)
        for number in range(first, last + 1):
            end_ns = self._first_ns + (number + 1) * STEP_NS
            if end_ns - STEP_NS >= samples[0][0]:
                self._correct(GridCell(self._first_number + number, end_ns, self._mean(end_ns)))
        self._complete()

    def _correct(self, cell: GridCell) -> None:
        waiting = len(self.fresh) - (self._count - cell.number)
        if waiting < 0:
            self.late.append(cell)
        else:
            self.fresh[waiting] = cell

    def _mean(self, end_ns: int) -> float:
        """Mean over the cell that ends then, of the samples joined by straight lines."""
        samples, start_ns = self._samples, end_ns - STEP_NS
        first, last = bisect_right(samples, (start_ns + 1,)), bisect_left(samples, (end_ns,))
        inner = samples[first:last]
        t_ns, value = start_ns, self._between(first, start_ns)
        area = 0.0
        for next_ns, next_value in [*inner, (end_ns, self._between(last, end_ns))]:
            area += (next_ns - t_ns) * 0.5 * (value + next_value)
            t_ns, value = next_ns, next_value
        return area / STEP_NS

    def _between(self, position: int, t_ns: int) -> float:
        """Return the value at a time between the samples before `position` and at it."""
        after_ns, after = self._samples[min(position, len(self._samples) - 1)]
        before_ns, before = self._samples[max(position - 1, 0)]
        if after_ns == before_ns:
            return after
        share = (t_ns - before_ns) / (after_ns - before_ns)
        return before + share * (after - before)


class History:
    """The last `capacity` values, in single precision; zeros stand before the first."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._values = np.zeros(3 * capacity, np.float32)
        self._end = capacity
        self.count = 0

    @property
    def newest(self) -> float:
        """The newest value."""
        return float(self._values[self._end - 1])

    def push(self, value: float) -> None:
        """Append a value."""
        values, capacity = self._values, self._capacity
        if self._end == len(values):
            values[:capacity] = values[-capacity:]
            self._end = capacity
        values[self._end] = value
        self._end += 1
        self.count += 1

    def rewrite(self, age: int, value: float) -> None:
        """Replace the value `age` steps before the newest; what is too old is left alone."""
        if age < min(self.count, self._capacity):
            self._values[self._end - 1 - age] = value

    def last(self, count: int) -> NDArray[np.float32]:
        """Return the newest `count` values, at most `capacity`; a view, until the next push."""
        return self._values[self._end - count : self._end]


# Every 10 ms up to 250 ms: the pulse ends below 40 Hz, and a cubic joins them.
SPACING, HORIZONS = 2, 25
AHEAD = SPACING * np.arange(1, HORIZONS + 1)
FURTHEST = SPACING * HORIZONS
Trajectories = NDArray[np.float64]


class Expert(Protocol):
    """Predicts a history's values `AHEAD` steps after the newest, in one or several ways.

    names: of its predictions; trust: the weight each has before the stack has learnt.
    """

    names: tuple[str, ...]
    trust: float

    def observe(self, history: History) -> None:
        """Take the value that was pushed; call once after each push."""

    def predict(self, history: History) -> Trajectories:
        """After `observe`: differences of those values from the newest, shape (names, 25).

        Zeros, which is to hold the newest, for as long as the expert knows nothing better.
        """

    def learn(self, history: History) -> None:
        """After `predict`: what of the work on the newest value can wait until then."""
