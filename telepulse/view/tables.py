"""Rolling tables of numbers by time, and their curves with fewer points. Pure."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]
Floats = NDArray[np.float64]
# Rows of a table of ticks or samples, 65 s at 1 kHz, and of one of statuses or beats.
FAST_ROWS, SLOW_ROWS = 1 << 16, 1 << 11
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
