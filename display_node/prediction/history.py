"""History of the pulse on its grid, and the range of its recent values."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.kernels import FLOATS, ROWS, kernel

Floats = NDArray[np.float64]
# Recent values are those of the last 5 s; their range is widened on both sides by this share of it.
RECENT: Final = 1_000
MARGIN: Final = 0.25
# Count of a value that was never there.
NEVER: Final = -(1 << 62)


@kernel(f"void({ROWS}, int64, int64, {FLOATS}, {FLOATS})")
def find_ranges(rows: NDArray[np.float32], end: int, count: int, low: Floats, high: Floats) -> None:
    """Write the widened range of the newest `count` values of each channel."""
    for channel in range(len(rows)):
        least = most = rows[channel, end - 1]
        for at in range(end - count, end):
            value = rows[channel, at]
            least = min(value, least)
            most = max(value, most)
        margin = MARGIN * (float(most) - float(least))
        low[channel], high[channel] = least - margin, most + margin


@kernel(f"void({ROWS}, int64, {FLOATS})")
def copy_newest(rows: NDArray[np.float32], end: int, newest: Floats) -> None:
    """Write the newest value of each channel."""
    for channel in range(len(rows)):
        newest[channel] = rows[channel, end - 1]


class History:
    """The last `capacity` values of a channel, and of others beside it, in single precision.

    They are filled with zeros at the start. buffer, end: for the kernels, a row for each channel
    whose newest value is before `end`.
    """

    def __init__(self, capacity: int, channels: int = 1) -> None:
        self._capacity = capacity
        self.buffer = np.zeros((channels, 3 * capacity), np.float32)
        # Of the first channel.
        self._values = self.buffer[0]
        self.end = capacity
        self.channels = channels
        # The signal of the first channel at the end of the newest cell, and a cell later.
        self.ahead = np.zeros(2)
        self.count = 0
        # Newest value of each channel.
        self._newest = np.zeros(channels)

    @property
    def newest(self) -> float:
        """The newest value."""
        return float(self._values[self.end - 1])

    def push(self, value: float, *others: float) -> None:
        """Append a value of each channel."""
        values, capacity = self._values, self._capacity
        if self.end == len(values):
            self.buffer[:, :capacity] = self.buffer[:, -capacity:]
            self.end = capacity
        values[self.end] = value
        for channel, other in enumerate(others, start=1):
            self.buffer[channel, self.end] = other
        self.end += 1
        self.count += 1
        self.ahead[:] = value

    def newest_of_each(self) -> Floats:
        """Return the newest value of each channel, shape (channels,), valid until the next call."""
        copy_newest(self.buffer, self.end, self._newest)
        return self._newest

    def rewrite(self, age: int, value: float, channel: int = 0) -> None:
        """Replace the value `age` steps before the newest; do nothing where it is too old."""
        if age < min(self.count, self._capacity):
            self.buffer[channel, self.end - 1 - age] = value

    def place_of(self, count: int) -> int:
        """Return the place in `buffer` of the value that was the newest at a count.

        It is negative where that value is too old.
        """
        age = self.count - count
        return self.end - 1 - age if age < self._capacity else -1

    def bounds(self, count: int, skipped: int) -> tuple[float, float]:
        """Return the widened range of the newest `count` values without the last `skipped` ones."""
        recent = self.last(min(count, self.count))[:-skipped]
        low, high = float(np.minimum.reduce(recent)), float(np.maximum.reduce(recent))
        margin = MARGIN * (high - low)
        return low - margin, high + margin

    def ranges(self, low: Floats, high: Floats) -> None:
        """Write the widened range of each channel's recent values, both of shape (channels,)."""
        find_ranges(self.buffer, self.end, min(RECENT, self.count), low, high)

    def last(self, count: int) -> NDArray[np.float32]:
        """Return a view of the newest `count` values (at most `capacity`), valid until a push."""
        values: NDArray[np.float32] = self._values[self.end - count : self.end]
        return values

    def rows(self, count: int) -> NDArray[np.float32]:
        """Return a view of the newest `count` values of each channel, valid until a push."""
        rows: NDArray[np.float32] = self.buffer[:, self.end - count : self.end]
        return rows
