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
MEMORY_NS = 1_500_000_000
# An error as large as this is as bad as any; so it is soon forgotten.
WORST = 0.3
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
        """Take a frame's samples, the first taken at t_ns."""
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

    What counts is its RMS over the last 1.5 s, over the pulse's height: a stall weighs as long as
    it lasts, and at each of its instants with the error at that horizon. What is not known counts
    as three tenths. Lost at once from 4 % on; won below 2.5 %, 10 s later at the earliest.
    """

    def __init__(self) -> None:
        self._power = WORST**2
        self._judged_ns: int | None = None
        self._lost_ns = 0
        self.trusted = False

    def judge(self, now_ns: int, error_n: float | None, size_n: float | None) -> None:
        """At each tick: the RMSE expected if E were 0 now, None if unknown; the pulse's size."""
        share = WORST
        if error_n is not None and size_n:
            share = min(error_n / size_n, WORST)
        if self._judged_ns is not None:
            weight = -math.expm1((self._judged_ns - now_ns) / MEMORY_NS)
            self._power += weight * (share * share - self._power)
        self._judged_ns = now_ns
        if self._power >= LOST_ABOVE**2:
            self.trusted, self._lost_ns = False, now_ns
        elif self._power <= GAINED_BELOW**2 and now_ns - self._lost_ns >= DWELL_NS:
            self.trusted = True


def auto_delay_ns(carried_ns: int, trusted: bool) -> int:
    """Return the E that `auto` wants, where the link could carry carried_ns."""
    return max(0, carried_ns - MOST_NS) if trusted else carried_ns
