"""Playout: which instant of the pulse is felt now, and which delay the link could carry.

The perceived delay E is the one knob: at time t the finger feels the pulse of t − E.
"""

import math
from collections import deque

BIN_NS = 1_000_000
BINS = 4_000
BASE_WINDOW_NS = 2_000_000_000
FORGET_NS = 10_000_000_000
RELEASE_PER_NS = 0.005
WARP = 0.02
JUMP_NS = 500_000_000
LATE_TARGET = 0.01
SETTLED_NS = 250_000_000


class DelayEstimator:
    """The smallest delay that keeps late samples below a target share.

    A forgetting histogram of the delay over its minimum of the last 2 s, and its quantile;
    rises at once, falls by 5 ms a second. Pure: delays and times come in.
    """

    def __init__(self, late_target: float = LATE_TARGET) -> None:
        self._late_target = late_target
        self._minima: deque[tuple[int, int]] = deque()
        self._weights = [0.0] * BINS
        self._weight = 1.0
        self._total = 0.0
        self._top = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        self.delay_ns: int | None = None

    @property
    def settled(self) -> bool:
        """Whether enough has been seen to start playing."""
        return self._first_ns is not None and self._last_ns - self._first_ns >= SETTLED_NS

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """A frame needed `delay_ns` from its first sample's instant to its arrival."""
        base_ns = self._base(delay_ns, now_ns)
        if self._first_ns is None:
            self._first_ns = self._last_ns = now_ns
        elapsed_ns = now_ns - self._last_ns
        self._last_ns = now_ns
        # Growing the new weight instead of shrinking all old ones forgets at the same rate.
        self._weight *= math.exp(elapsed_ns / FORGET_NS)
        if self._weight > 1e100:
            self._weights = [weight / self._weight for weight in self._weights]
            self._total /= self._weight
            self._weight = 1.0
        position = min((delay_ns - base_ns) // BIN_NS, BINS - 1)
        self._weights[position] += self._weight
        self._total += self._weight
        wanted_ns = base_ns + self._quantile_ns(position)
        if self.delay_ns is None or wanted_ns >= self.delay_ns:
            self.delay_ns = wanted_ns
        else:
            self.delay_ns = max(wanted_ns, self.delay_ns - round(RELEASE_PER_NS * elapsed_ns))

    def _base(self, delay_ns: int, now_ns: int) -> int:
        """Minimum of the last 2 s, by a queue of rising candidates."""
        while self._minima and self._minima[-1][1] >= delay_ns:
            self._minima.pop()
        self._minima.append((now_ns, delay_ns))
        while self._minima[0][0] < now_ns - BASE_WINDOW_NS:
            self._minima.popleft()
        return self._minima[0][1]

    def _quantile_ns(self, newest_position: int) -> int:
        """Upper edge of the bin above which at most the late target's share of weight lies."""
        allowed = self._late_target * self._total
        above = 0.0
        for position in range(self._highest(newest_position), -1, -1):
            above += self._weights[position]
            if above > allowed:
                return (position + 1) * BIN_NS
        return BIN_NS

    def _highest(self, position: int) -> int:
        """The highest bin in use, remembered so that quantiles do not walk empty bins."""
        self._top = max(position, self._top)
        negligible = self._weight * 1e-9
        while self._top and self._weights[self._top] < negligible:
            self._top -= 1
        return self._top


class PlayoutClock:
    """Turns time into the instant played, never faster or slower than a time-warp of 2 %.

    Changes of E and corrections of the clock offset are both slewed, so the finger feels no
    jump; a difference above 0.5 s (a clock that stepped, a new session) is jumped and counted.
    """

    def __init__(self) -> None:
        self._now_ns: int | None = None
        self._instant_ns = 0
        self.jumps = 0

    def instant(self, now_ns: int, wanted_ns: int) -> int:
        """The instant to play at local time `now_ns`, when `wanted_ns` is where it should be.

        Both clocks run at one rate within the warp; the result never goes back but by a jump.
        """
        if self._now_ns is None:
            self._now_ns, self._instant_ns = now_ns, wanted_ns
            return wanted_ns
        elapsed_ns = now_ns - self._now_ns
        error_ns = wanted_ns - self._instant_ns - elapsed_ns
        if abs(error_ns) > JUMP_NS:
            self.jumps += 1
        else:
            bound_ns = WARP * elapsed_ns
            error_ns = round(min(max(error_ns, -bound_ns), bound_ns))
        self._instant_ns += elapsed_ns + error_ns
        self._now_ns = now_ns
        return self._instant_ns
