"""The delay that the link requires: the smallest one that keeps late samples below a target share.

The delay of a frame is the time from its first sample to its arrival. `DelayEstimator` follows the
delays of all frames; `display_node/playout.py` plays the samples that much later, or less where a
trusted predictor replaces a part of the delay. Pure.
"""

import math
from collections import deque
from typing import Final

from display_node.reception.playout_clock import JUMP_NS, WARP_PARTS

BIN_NS: Final = 1_000_000
BINS: Final = 11_000


class ExponentialQuantile:
    """Quantile of a stream of values in which older values have exponentially less weight.

    The histogram has bins of 1 ms from 0 to 11 s. The quantile's bin is stored, so that counting a
    value takes only a step or two. share_above: share of the weight above the quantile.
    """

    def __init__(self, share_above: float) -> None:
        self._share_above = share_above
        self._weights = [0.0] * BINS
        self._weight = 1.0
        self._total = 0.0
        # The quantile's bin and the weight above it.
        self._position = 0
        self._above = 0.0

    def add(self, value_ns: int, forgetting: float) -> int:
        """Count a value of 0 or more; return the upper edge in ns of the quantile's bin.

        forgetting: factor by which the weight of earlier values shrinks, above 0 and at most 1.
        """
        # The weight of new values grows, which has the effect of shrinking those of all old ones.
        self._weight /= forgetting
        if self._weight > 1e100:
            scale = 1 / self._weight
            self._weights = [weight * scale for weight in self._weights]
            self._total *= scale
            self._above *= scale
            self._weight = 1.0
        weights, weight = self._weights, self._weight
        counted = min(value_ns // BIN_NS, BINS - 1)
        weights[counted] += weight
        self._total += weight
        allowed = self._share_above * self._total
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
        return (position + 1) * BIN_NS


BASE_NS: Final = 2_000_000_000
# A silence gives no evidence about the path, so it ages the base by no more than this.
SILENCE_NS: Final = 200_000_000
# The delay falls no faster, since the playout could not follow.
RELEASE_PER_NS: Final = 1 / WARP_PARTS
# Delays that are far above the base for this time, and do not fall, are those of a longer path.
LONGER_AFTER_NS: Final = 50_000_000
FALLING_NS: Final = 10_000_000
FAR_ABOVE: Final = 2


class LongerPath:
    """Detector of delays that stay above a limit for `after_ns` without falling.

    The delays of queued frames fall from each frame to the next, back to the earlier level. Those
    of frames on a longer path stay. since_ns: start of the present stay above the limit, or None.
    """

    def __init__(self, after_ns: int) -> None:
        self._after_ns = after_ns
        self.since_ns: int | None = None
        self._level_ns = 0

    def base_ns(self, delay_ns: int, limit_ns: int, now_ns: int) -> int | None:
        """Return the longer path's base once this frame's delay has made it certain, else None."""
        if delay_ns <= limit_ns:
            self.since_ns = None
        elif self.since_ns is None or delay_ns < self._level_ns - FALLING_NS:
            self.since_ns, self._level_ns = now_ns, delay_ns
        elif now_ns - self.since_ns >= self._after_ns:
            self.since_ns = None
            return min(delay_ns, self._level_ns)
        return None


class DelayTracker:
    """Delay that a link requires: its base plus a quantile of the delay above the base.

    The base is the smallest delay of the last 2 s. The result rises at once and falls by 50 ms a
    second.

    Parameters
    ----------
    follows_longer_path
        Whether a burst of long delays is taken for a longer path, not for jitter: the base is then
        raised after 50 ms in which all delays were more than twice as far above it as usual.
    max_slew
        Greatest rate of change of the playout delay, in seconds a second.

    Attributes
    ----------
    late_share
        Share of frames that are late in a playout that follows this tracker.
    mean_ns
        Mean of the required delay.
    """

    def __init__(self, late_target: float, follows_longer_path: bool, max_slew: float) -> None:
        self._reach = ExponentialQuantile(late_target)
        self._longer = LongerPath(LONGER_AFTER_NS) if follows_longer_path else None
        self._max_slew = max_slew
        # Sliding minimum: times and delays rise, so the first entry has the smallest delay.
        self._window: deque[tuple[int, int]] = deque()
        self._elapsed_ns = 0
        self._delay_ns: int | None = None
        self._followed_ns = 0.0
        # Sums over frames, exponentially weighted.
        self._count = self._excess_ns = self._delays_ns = self._late = 0.0
        self.late_share = self.mean_ns = 0.0

    def set_base(self, base_ns: int) -> None:
        """Set the base to that of a longer path; smaller delays so far are discarded."""
        self._window.clear()
        self._window.append((self._elapsed_ns, base_ns))

    def observe(self, delay_ns: int, now_ns: int, elapsed_ns: int, forgetting: float) -> int:
        """Take a frame `elapsed_ns` after the last one; return the delay that is required now.

        forgetting: factor by which the weight of earlier values shrinks.
        """
        self._elapsed_ns += min(elapsed_ns, SILENCE_NS)
        window = self._window
        # The base before this frame: with it, the frame may have been late.
        base_ns = window[0][1] if window else delay_ns
        excess_ns = max(delay_ns - base_ns, 0)
        reach_ns = self._reach.add(excess_ns, forgetting)
        self._count = self._count * forgetting + 1
        self._excess_ns = self._excess_ns * forgetting + excess_ns
        if self._longer is not None:
            limit_ns = base_ns + int(FAR_ABOVE * self._excess_ns / self._count)
            longer_ns = self._longer.base_ns(delay_ns, limit_ns, now_ns)
            if longer_ns is not None:
                self.set_base(longer_ns)
        while window and window[-1][1] >= delay_ns:
            window.pop()
        window.append((self._elapsed_ns, delay_ns))
        while window[0][0] <= self._elapsed_ns - BASE_NS:
            window.popleft()
        asked_ns = released(self._delay_ns, window[0][1] + reach_ns, elapsed_ns)
        self._score(delay_ns, asked_ns, elapsed_ns, forgetting)
        self._delay_ns = asked_ns
        return asked_ns

    def _score(self, delay_ns: int, asked_ns: int, elapsed_ns: int, forgetting: float) -> None:
        if self._delay_ns is None:
            self._followed_ns = float(asked_ns)
        else:
            room_ns = self._max_slew * elapsed_ns
            missing_ns = self._delay_ns - self._followed_ns
            self._followed_ns += min(max(missing_ns, -room_ns), room_ns)
        self._late = self._late * forgetting + (delay_ns > self._followed_ns)
        self._delays_ns = self._delays_ns * forgetting + asked_ns
        self.late_share, self.mean_ns = self._late / self._count, self._delays_ns / self._count


def released(delay_ns: int | None, wanted_ns: int, elapsed_ns: int) -> int:
    """Return the next delay on the way to `wanted_ns`: up at once, down by 50 ms a second."""
    if delay_ns is None or wanted_ns >= delay_ns or delay_ns - wanted_ns > JUMP_NS:
        return wanted_ns
    return max(wanted_ns, delay_ns - round(RELEASE_PER_NS * elapsed_ns))


# Range of delays: below 0 while the clock is poorly known, up to the longest compensation.
LOWEST_NS: Final = -1_000_000_000
HIGHEST_NS: Final = 9_999_000_000
# Long enough to contain some late frames, which are about 1 %.
FORGET_NS: Final = 60_000_000_000
LATE_TARGET: Final = 0.01
SETTLED_NS: Final = 250_000_000
# Delays this far above the estimate are an outage's backlog, unless they last longer.
OUTAGE_NS: Final = 500_000_000
OUTAGE_ENDS_NS: Final = 1_000_000_000


class DelayEstimator:
    """Estimator of the smallest delay that keeps late samples below a target share.

    One tracker takes a burst of long delays for jitter and covers it with a longer delay; the other
    takes it for a longer path and follows it. The second is used where its mean delay is smaller
    and the playout is fast enough to follow. Frames that queued during a cut are left out, as their
    delays are not jitter.

    Parameters
    ----------
    late_target
        Share of samples that may be late, above 0 and below 1.
    max_slew
        Greatest rate of change of the playout delay, in seconds a second; infinity for a playout
        that jumps.

    Attributes
    ----------
    delay_ns
        The delay in ns, at most 9.999 s; None before the first frame.
    settled
        Whether enough frames have come to start playing.
    """

    def __init__(self, late_target: float = LATE_TARGET, max_slew: float = 1 / WARP_PARTS) -> None:
        self._late_target = late_target
        self._covering = DelayTracker(late_target, follows_longer_path=False, max_slew=max_slew)
        self._following = DelayTracker(late_target, follows_longer_path=True, max_slew=max_slew)
        self._outage = LongerPath(OUTAGE_ENDS_NS)
        self._first_ns: int | None = None
        self._last_ns = 0
        self.delay_ns: int | None = None
        self.settled = False

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """Take a frame's delay, from its first sample's instant to its arrival.

        The delay may be below 0 while the clock offset is not well known; it is clipped to −1 s and
        10 s.
        """
        if self._first_ns is None:
            self._first_ns = self._last_ns = now_ns
        delay_ns = min(max(delay_ns, LOWEST_NS), HIGHEST_NS)
        if self._is_backlog(delay_ns, now_ns):
            return
        elapsed_ns = now_ns - self._last_ns
        self._last_ns = now_ns
        self.settled = now_ns - self._first_ns >= SETTLED_NS
        # The bound prevents an underflow after a silence of hours; old values then have no weight.
        forgetting = math.exp(-min(elapsed_ns / FORGET_NS, 100.0))
        covering, following = self._covering, self._following
        covering_ns = covering.observe(delay_ns, now_ns, elapsed_ns, forgetting)
        following_ns = following.observe(delay_ns, now_ns, elapsed_ns, forgetting)
        # Where both cost about the same, following is preferred because it adapts first.
        dearer_ns = following.mean_ns - covering.mean_ns
        later = following.late_share - covering.late_share
        follows = dearer_ns < BIN_NS and later < self._late_target
        wanted_ns = following_ns if follows else covering_ns
        self.delay_ns = min(released(self.delay_ns, wanted_ns, elapsed_ns), HIGHEST_NS)

    def _is_backlog(self, delay_ns: int, now_ns: int) -> bool:
        """Return whether the frame was queued during an outage, and not sent on a longer path."""
        outage = self._outage
        if self.delay_ns is None:
            return False
        # Once a backlog has begun, every frame up to the first one on time belongs to it.
        spared_ns = OUTAGE_NS if outage.since_ns is None else 0
        base_ns = outage.base_ns(delay_ns, self.delay_ns + spared_ns, now_ns)
        if base_ns is not None:
            self._covering.set_base(base_ns)
            self._following.set_base(base_ns)
        return outage.since_ns is not None
