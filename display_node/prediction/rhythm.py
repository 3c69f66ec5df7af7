"""The rhythm: when beats began, by the slope's rise through a share of its usual peak."""

import statistics

BEATS = 9
FEWEST = 4
SHARE = 0.45
# Two beats are at least so many steps apart: 250 ms.
REFRACTORY = 50
# Before peaks are known: the highest slope yet, which fades with a time constant of 3 s.
FADE = 1 - 1 / 600


class Rhythm:
    """Follows the beats of a signal on the grid.

    interval: the median of the last beats' intervals in steps; None before there are any.
    """

    def __init__(self) -> None:
        self.interval: float | None = None
        self._intervals: list[int] = []
        self._peaks: list[float] = []
        self._peak = self._highest = self._slope = 0.0
        self._threshold = float("inf")
        self._step = 0
        self._beat_step: int | None = None

    def push(self, slope: float) -> None:
        """The slope at the next step."""
        self._step += 1
        rested = self._beat_step is None or self._step - self._beat_step > REFRACTORY
        if self._slope < self._threshold <= slope and rested:
            self._beat()
        self._slope = slope
        self._peak = max(self._peak, slope)
        self._highest = max(self._highest * FADE, slope)
        if self.interval is None and self._highest > 0:
            self._threshold = SHARE * self._highest

    def _beat(self) -> None:
        if self._beat_step is not None:
            self._peaks = [*self._peaks[1 - BEATS :], self._peak]
            self._intervals = [*self._intervals[1 - BEATS :], self._step - self._beat_step]
            if len(self._peaks) >= FEWEST:
                self._threshold = SHARE * statistics.median(self._peaks)
                self.interval = statistics.median(self._intervals)
        self._peak = 0.0
        self._beat_step = self._step
