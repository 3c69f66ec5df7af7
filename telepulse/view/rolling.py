"""The newest rows of a table that grows without end, and curves of no more points than a screen
shows. Pure."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]
Floats = NDArray[np.float64]
# A gap in a thinned curve is one where so many of its buckets would be empty.
EMPTY_BUCKETS = 3


class Stretch(NamedTuple):
    """Rows in order of time. first: how many rows came before them; values: a column each."""

    first: int
    t_ns: Times
    values: Floats


class Rolling:
    """The newest rows, `capacity` of them at least and twice as many at most."""

    def __init__(self, columns: int, capacity: int) -> None:
        self._capacity = capacity
        self._t_ns = np.empty(2 * capacity, np.int64)
        self._values = np.empty((2 * capacity, columns))
        self._end = self._dropped = 0

    def __len__(self) -> int:
        return self._end

    def add(self, t_ns: int, *values: float) -> None:
        """A row that is newer than those before."""
        self._make_room(1)
        self._t_ns[self._end] = t_ns
        self._values[self._end] = values
        self._end += 1

    def insert(self, t_ns: Times, values: Floats) -> None:
        """Rows in order of time, of shape (rows, columns); they may belong between older ones."""
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
        """Whether there is a row so near to a time."""
        at = int(np.searchsorted(self._t_ns[: self._end], t_ns - within_ns))
        return at < self._end and int(self._t_ns[at]) <= t_ns + within_ns

    def since(self, t_ns: int) -> Stretch:
        """The rows from a time on; views, good until the next row comes."""
        at = int(np.searchsorted(self._t_ns[: self._end], t_ns))
        first = self._dropped + at
        return Stretch(first, self._t_ns[at : self._end], self._values[at : self._end])

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
    """A curve of about `points` points at most: of each bucket its least and greatest value.

    Buckets are the same from call to call, told by `first`, how many rows came before: what is
    drawn stays as it is while it moves. Where nothing came for longer than gap_ns stands a NaN,
    which breaks the line.
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
