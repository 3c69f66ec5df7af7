"""History of the pulse on its grid, and the range of its recent values."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.kernels import FLOATS, ROWS, TABLE, kernel

Floats = NDArray[np.float64]
# Recent values are those of the last 5 s; their range is widened on both sides by this share of it.
RECENT: Final = 1_000
MARGIN: Final = 0.25
# Values that contain the pulse's height: those of the last 4 s, as in the scores.
HEIGHT: Final = 800
# Count of a value that was never there.
NEVER: Final = -(1 << 62)


@kernel(f"void({ROWS}, int64, int64, float64, {TABLE})")
def find_ranges(
    rows: NDArray[np.float32], end: int, count: int, widened: float, ranges: Floats
) -> None:
    """Write the range of the newest `count` values of each channel, shape (2, channels).

    widened: share of it by which it is widened on both sides.
    """
    for channel in range(len(rows)):
        least = most = rows[channel, end - 1]
        for at in range(end - count, end):
            value = rows[channel, at]
            least = min(value, least)
            most = max(value, most)
        margin = widened * (float(most) - float(least))
        ranges[0, channel], ranges[1, channel] = least - margin, most + margin


@kernel(f"float64({FLOATS}, int64, int64)")
def mean_about(sums: Floats, place: int, width: int) -> float:
    """Return the mean of the first channel's values at a place and `width` steps to both sides."""
    total: float = sums[place + width + 1] - sums[place - width]
    return total / (2 * width + 1)


class History:
    """The last `capacity` values of a channel, and of others beside it, in single precision.

    They are filled with zeros at the start. buffer, end: for the kernels, a row for each channel
    whose newest value is before `end`. sums: of the first channel's values before each place, for
    means over any width. newest_of_each: newest value of each channel, in single precision. ahead:
    the signal of each channel at the end of the newest cell, and a cell later.
    """

    def __init__(self, capacity: int, channels: int = 1) -> None:
        self._capacity = capacity
        self.buffer = np.zeros((channels, 3 * capacity), np.float32)
        # Of the first channel.
        self._values = self.buffer[0]
        self.sums = np.zeros(3 * capacity + 1)
        self.end = capacity
        self.channels = channels
        self.ahead = np.zeros((channels, 2))
        self.count = 0
        self.newest_of_each = np.zeros(channels)

    @property
    def newest(self) -> float:
        """The newest value."""
        return self.newest_of_each.item(0)

    def push(self, value: float, *others: float) -> None:
        """Append a value of each channel. Until `ahead` is written, it holds the values."""
        values, sums, end, capacity = self._values, self.sums, self.end, self._capacity
        if end == len(values):
            self.buffer[:, :capacity] = self.buffer[:, -capacity:]
            end = capacity
            # They begin at 0 again, since rounding grows with a sum.
            sums[: capacity + 1] = sums[-capacity - 1 :] - sums[-capacity - 1]
        values[end] = value
        kept = values.item(end)
        sums[end + 1] = sums.item(end) + kept
        self.newest_of_each[0] = kept
        ahead = self.ahead
        ahead[0, 0] = ahead[0, 1] = kept
        for channel, other in enumerate(others, start=1):
            self.buffer[channel, end] = other
            self.newest_of_each[channel] = ahead[channel, :] = self.buffer[channel, end]
        self.end = end + 1
        self.count += 1

    def change(self, steps: int) -> float:
        """Return the first channel's change over the last steps."""
        values, newest = self._values, self.end - 1
        change: float = values.item(newest) - values.item(newest - steps)
        return change

    def rewrite(self, age: int, value: float, channel: int = 0) -> None:
        """Replace the value `age` steps before the newest; do nothing where it is too old."""
        if age < min(self.count, self._capacity):
            place = self.end - 1 - age
            before = self.buffer.item(channel, place)
            self.buffer[channel, place] = value
            if channel == 0:
                self.sums[place + 1 : self.end + 1] += self.buffer.item(0, place) - before
            self.newest_of_each[channel] = self.buffer[channel, self.end - 1]

    def place_of(self, count: int) -> int:
        """Return the place in `buffer` of the value that was the newest at a count.

        It is negative where that value is too old.
        """
        age = self.count - count
        return self.end - 1 - age if age < self._capacity else -1

    @np.errstate(all="ignore")
    def bounds(self, count: int, skipped: int) -> tuple[float, float]:
        """Return the widened range of the newest `count` values without the last `skipped` ones."""
        recent = self.last(min(count, self.count))[:-skipped]
        low, high = float(np.minimum.reduce(recent)), float(np.maximum.reduce(recent))
        margin = MARGIN * (high - low)
        return low - margin, high + margin

    def ranges(self, ranges: Floats) -> None:
        """Write the widened range of each channel's recent values, low and high."""
        find_ranges(self.buffer, self.end, min(RECENT, self.count), MARGIN, ranges)

    def heights(self) -> Floats:
        """Return the height of each channel's pulse: the range of the last 4 s."""
        ranges = np.empty((2, self.channels))
        find_ranges(self.buffer, self.end, min(HEIGHT, self.count), 0.0, ranges)
        heights: Floats = ranges[1] - ranges[0]
        return heights

    def last(self, count: int) -> NDArray[np.float32]:
        """Return a view of the newest `count` values (at most `capacity`), valid until a push."""
        values: NDArray[np.float32] = self._values[self.end - count : self.end]
        return values

    def rows(self, count: int) -> NDArray[np.float32]:
        """Return a view of the newest `count` values of each channel, valid until a push."""
        rows: NDArray[np.float32] = self.buffer[:, self.end - count : self.end]
        return rows
