"""Compensation: whether the predictor may be trusted with all of the delay.

`auto` plays at the delay that the link can carry, and at E = 0 while the predictor is trusted.
Pure: errors, sizes and times come in.
"""

import math
import statistics
from collections import deque

# Of the pulse's height; a finger notices differences from 7 to 10 % on, 2.5 times the RMSE.
LOST_ABOVE = 0.04
GAINED_BELOW = 0.025
DWELL_NS = 10_000_000_000
MEMORY_NS = 1_000_000_000
# A window holds a whole beat down to 30 a minute; an artefact spoils one window or two.
WINDOW_NS = 2_000_000_000
WINDOWS = 5
# What trust takes off E at most: the playout jumps by more than 0.5 s, and slews below.
MOST_NS = 400_000_000


class PulseSize:
    """The pulse's height from foot to peak: the median over the last windows of 2 s."""

    def __init__(self) -> None:
        self._sizes: deque[float] = deque(maxlen=WINDOWS)
        self._begun_ns: int | None = None
        self._low = self._high = 0.0
        self.size: float | None = None

    def observe(self, t_ns: int, values: list[float]) -> None:
        """A frame's samples, the first taken at t_ns."""
        low, high = min(values), max(values)
        if self._begun_ns is not None and t_ns - self._begun_ns < WINDOW_NS:
            self._low, self._high = min(self._low, low), max(self._high, high)
            return
        if self._begun_ns is not None:
            self._sizes.append(self._high - self._low)
            self.size = statistics.median(self._sizes)
        self._begun_ns, self._low, self._high = t_ns, low, high


class Trust:
    """Whether the predictor's error would go unnoticed at E = 0.

    What counts is the RMS over the last second of the error expected at the horizons that E = 0
    asks for, over the pulse's height; what is not known counts as the whole pulse. Lost at once
    above 4 %; won after 10 s below 2.5 %.
    """

    def __init__(self) -> None:
        self._power = 1.0
        self._judged_ns: int | None = None
        self._good_since_ns: int | None = None
        self.trusted = False

    def judge(self, now_ns: int, error_n: float | None, size_n: float | None) -> None:
        """Before a frame is taken: the error expected of predictions from the frame before it."""
        share = 1.0
        if error_n is not None and size_n:
            share = min(error_n / size_n, 1.0)
        if self._judged_ns is not None:
            weight = -math.expm1((self._judged_ns - now_ns) / MEMORY_NS)
            self._power += weight * (share * share - self._power)
        self._judged_ns = now_ns
        if self.trusted:
            self.trusted = self._power < LOST_ABOVE**2
        elif self._power > GAINED_BELOW**2:
            self._good_since_ns = None
        elif self._good_since_ns is None:
            self._good_since_ns = now_ns
        elif now_ns - self._good_since_ns >= DWELL_NS:
            self.trusted, self._good_since_ns = True, None


def auto_delay_ns(carried_ns: int, trusted: bool) -> int:
    """The E that `auto` wants, where the link could carry carried_ns."""
    return max(0, carried_ns - MOST_NS) if trusted else carried_ns
