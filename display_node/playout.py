"""Playout: which instant of the pulse is felt now, and which delay the link could carry.

The perceived delay E is the one knob: at time t the finger feels the pulse of t − E.
"""

import math

# Every delay from a clock that is still poorly known to the longest compensation has its bin.
LOWEST_NS = -1_000_000_000
BIN_NS = 1_000_000
BINS = 11_000
FORGET_NS = 10_000_000_000
RELEASE_PER_NS = 0.005
# A time-warp of at most one part in 50: 2 %.
WARP_PARTS = 50
JUMP_NS = 500_000_000
LATE_TARGET = 0.01
SETTLED_NS = 250_000_000
# Delays this far above the estimate are an outage's backlog, unless they go on for so long.
OUTAGE_NS = 500_000_000
OUTAGE_ENDS_NS = 1_000_000_000


class DelayEstimator:
    """The smallest delay that keeps late samples below a target share.

    A forgetting histogram of the delay and its quantile; rises at once, falls by 5 ms a
    second. What was queued while the link was cut says nothing of its jitter and is left out.
    Pure: delays and times come in.
    """

    def __init__(self, late_target: float = LATE_TARGET) -> None:
        self._late_target = late_target
        self._weights = [0.0] * BINS
        self._weight = 1.0
        self._total = 0.0
        # The quantile's bin and the weight above it, both carried on from frame to frame.
        self._position = 0
        self._above = 0.0
        self._backlog_since_ns: int | None = None
        self._first_ns: int | None = None
        self._last_ns = 0
        self.delay_ns: int | None = None

    @property
    def settled(self) -> bool:
        """Whether enough has been seen to start playing."""
        return self._first_ns is not None and self._last_ns - self._first_ns >= SETTLED_NS

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """A frame needed `delay_ns` from its first sample's instant to its arrival."""
        if self._first_ns is None:
            self._first_ns = self._last_ns = now_ns
        elapsed_ns = now_ns - self._last_ns
        self._last_ns = now_ns
        self._forget(elapsed_ns)
        if self._is_backlog(delay_ns, now_ns):
            return
        wanted_ns = LOWEST_NS + (self._quantile_position(delay_ns) + 1) * BIN_NS
        if self.delay_ns is None or wanted_ns >= self.delay_ns:
            self.delay_ns = wanted_ns
        else:
            self.delay_ns = max(wanted_ns, self.delay_ns - round(RELEASE_PER_NS * elapsed_ns))

    def _is_backlog(self, delay_ns: int, now_ns: int) -> bool:
        """Whether a frame was held up by an outage; a longer path shows itself by lasting."""
        if self.delay_ns is None or delay_ns < self.delay_ns + OUTAGE_NS:
            self._backlog_since_ns = None
            return False
        if self._backlog_since_ns is None:
            self._backlog_since_ns = now_ns
        return now_ns - self._backlog_since_ns < OUTAGE_ENDS_NS

    def _forget(self, elapsed_ns: int) -> None:
        """Grow the weight of what comes next, which forgets like shrinking all old ones."""
        # The bound keeps a silence of hours from overflowing; nothing is left of the old then.
        self._weight *= math.exp(min(elapsed_ns / FORGET_NS, 100.0))
        if self._weight > 1e100:
            scale = 1 / self._weight
            self._weights = [weight * scale for weight in self._weights]
            self._total *= scale
            self._above *= scale
            self._weight = 1.0

    def _quantile_position(self, delay_ns: int) -> int:
        """Count a delay; the lowest bin above which at most the late target's share lies."""
        weights, weight = self._weights, self._weight
        counted = min(max((delay_ns - LOWEST_NS) // BIN_NS, 0), BINS - 1)
        weights[counted] += weight
        self._total += weight
        allowed = self._late_target * self._total
        position, above = self._position, self._above
        if counted > position:
            above += weight
        while above > allowed:
            position += 1
            above -= weights[position]
        while position and above + weights[position] <= allowed:
            above += weights[position]
            position -= 1
        self._position, self._above = position, above
        return position


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
        elif abs(error_ns) > elapsed_ns // WARP_PARTS:
            error_ns = elapsed_ns // WARP_PARTS * (1 if error_ns > 0 else -1)
        self._instant_ns += elapsed_ns + error_ns
        self._now_ns = now_ns
        return self._instant_ns
