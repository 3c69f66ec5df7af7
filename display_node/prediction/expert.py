"""What every expert of the stack is: predictions over a common row of horizons.

The grid's newest values, oldest first, contiguous however far back one looks.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


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
        """The newest `count` values, at most `capacity`; a view that the next push invalidates."""
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
        """A value was pushed; call once after each push."""

    def predict(self, history: History) -> Trajectories:
        """After `observe`: differences of those values from the newest, shape (names, 25).

        Zeros, which is to hold the newest, for as long as the expert knows nothing better.
        """

    def learn(self, history: History) -> None:
        """After `predict`: what of the work on the newest value can wait until then."""
