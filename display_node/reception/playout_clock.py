"""Playout: which instant of the pulse is felt now, and which delay the link could carry.

The perceived delay E is the one knob: at time t the finger feels the pulse of t − E.

Statistics of the delays of all ticks that were played.
"""

import math

from display_node.reception.delay_estimator import (
    BIN_NS,
    JUMP_NS,
    DelayTracker,
    LongerPath,
    released,
)
from protocol.histogram import Histogram
from protocol.run_summary import Compensation, PlayoutDelay


class PlayedDelays:
    """Counts the ticks while the stream was alive: `ticks` of them."""

    def __init__(self) -> None:
        self._playout_delay_ms = Histogram(0.5, 8_000)
        self._covered_ns = 0
        self._predicted = self._trusted = 0
        self.ticks = 0

    def add(self, playout_delay_ns: int, predicted_ns: int, trusted: bool) -> None:
        """A tick: its E, by how much the newest sample was older than what was played (0 where
        that was there), and whether the predictor was trusted."""
        self._playout_delay_ms.add(playout_delay_ns * 1e-6)
        self._covered_ns += playout_delay_ns + predicted_ns
        self.ticks += 1
        self._predicted += predicted_ns > 0
        self._trusted += trusted

    @property
    def playout_delay_ms(self) -> PlayoutDelay:
        """Perceived delay E, in ms."""
        delay_ms = self._playout_delay_ms
        return PlayoutDelay(delay_ms.mean, delay_ms.quantile(0.99), delay_ms.beyond(p99=0.99))

    @property
    def covered_delay_ms(self) -> float | None:
        """Mean of what was buffered and predicted together, in ms."""
        return self._covered_ns / self.ticks * 1e-6 if self.ticks else None

    def compensation(self, may_trust: bool) -> Compensation:
        """Shares of the ticks; none of trust where the scene leaves it no say."""
        if not self.ticks:
            return Compensation()
        trusted = self._trusted / self.ticks if may_trust else None
        return Compensation(self._predicted / self.ticks, trusted)


# Every delay from a clock that is still poorly known to the longest compensation.
LOWEST_NS = -1_000_000_000
HIGHEST_NS = 9_999_000_000
# A share of 1 % needs some events of its own to be seen in.
FORGET_NS = 60_000_000_000
# A time-warp of at most one part in 50: 2 %.
WARP_PARTS = 50
LATE_TARGET = 0.01
SETTLED_NS = 250_000_000
# Delays this far above the estimate are an outage's backlog, unless they go on for so long.
OUTAGE_NS = 500_000_000
OUTAGE_ENDS_NS = 1_000_000_000


class DelayEstimator:
    """The smallest delay that keeps late samples below a target share.

    Two trackers read the link (see `DelayTracker`): to one, a burst of long delays is jitter that
    has to be covered; to the other, a longer path that can be followed. Following is done where it
    takes less delay on average and the playout, whose time is warped by `warp` at most (infinity:
    it jumps), is not too slow for it. What was queued while the link was cut says nothing of its
    jitter and is left out. Pure: delays and times come in.
    """

    def __init__(self, late_target: float = LATE_TARGET, warp: float = 1 / WARP_PARTS) -> None:
        self._late_target = late_target
        self._covering = DelayTracker(late_target, follows=False, warp=warp)
        self._following = DelayTracker(late_target, follows=True, warp=warp)
        self._outage = LongerPath(OUTAGE_ENDS_NS)
        self._first_ns: int | None = None
        self._last_ns = 0
        self.delay_ns: int | None = None

    @property
    def settled(self) -> bool:
        """Whether enough has been seen to start playing."""
        return self._first_ns is not None and self._last_ns - self._first_ns >= SETTLED_NS

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """A frame needed `delay_ns` from its first sample's instant to its arrival.

        It is below 0 while the clock offset is not well known; counted within −1 s and 10 s.
        """
        if self._first_ns is None:
            self._first_ns = self._last_ns = now_ns
        delay_ns = min(max(delay_ns, LOWEST_NS), HIGHEST_NS)
        if self._is_backlog(delay_ns, now_ns):
            return
        elapsed_ns = now_ns - self._last_ns
        self._last_ns = now_ns
        # The bound keeps a silence of hours from underflowing; nothing is left of the old then.
        kept = math.exp(-min(elapsed_ns / FORGET_NS, 100.0))
        covering_ns = self._covering.observe(delay_ns, now_ns, elapsed_ns, kept)
        following_ns = self._following.observe(delay_ns, now_ns, elapsed_ns, kept)
        wanted_ns = following_ns if self._follows() else covering_ns
        self.delay_ns = min(released(self.delay_ns, wanted_ns, elapsed_ns), HIGHEST_NS)

    def _follows(self) -> bool:
        """Whether to follow. Preferred where it hardly matters: it is first to be right."""
        covering, following = self._covering, self._following
        dearer_ns = following.mean_ns - covering.mean_ns
        later = following.late_share - covering.late_share
        return dearer_ns < BIN_NS and later < self._late_target

    def _is_backlog(self, delay_ns: int, now_ns: int) -> bool:
        """Whether a frame was held up by an outage; a longer path shows itself by lasting."""
        if self.delay_ns is None:
            return False
        # Once a backlog has begun, all of it is left out, down to the first frame on time.
        spared_ns = 0 if self._outage.suspected else OUTAGE_NS
        base_ns = self._outage.base_ns(delay_ns, self.delay_ns + spared_ns, now_ns)
        if base_ns is not None:
            self._covering.lift(base_ns)
            self._following.lift(base_ns)
        return self._outage.suspected


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
