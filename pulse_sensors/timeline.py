"""One regular row of samples on the host's clock, from packets and what is known of their times.

A delay-locked loop (F. Adriaensen, "Using a DLL to filter time", 2005): the next sample's time
is predicted, and each measured time pulls prediction and period a little its way. So what a
stream says of its times is even and never steps back, whatever jitter the measuring has.
"""

import math
from typing import NamedTuple

# Of the loop, once it has settled; until then as much as the time seen so far allows.
BANDWIDTH_HZ = 0.2
SETTLING = 0.5
LARGEST_OMEGA = 0.3
# Samples stretched by more than this would be felt, and displays take half or double at most.
LARGEST_STRETCH = 0.2
LARGEST_RATE_ERROR = 0.5
# Beyond this it is no jitter: samples are missing, or the time is wrong.
JUMP_NS = 250_000_000


class Span(NamedTuple):
    """Where samples lie: the first's time, when the one after the last would come, and how many
    are missing right before them."""

    first_ns: int
    end_ns: int
    missing: int


class Timeline:
    """Gives every sample its place. Pure: measured times on the host's clock come in."""

    def __init__(self, period_ns: int) -> None:
        """period_ns: the nominal one."""
        self._nominal_ns = period_ns
        self._period_ns = float(period_ns)
        # Times as differences to the first, which are exact as floats.
        self._origin_ns: int | None = None
        self._next_ns = 0.0
        self._measured_ns = 0.0

    def place(self, count: int, missing: int, last_ns: int) -> Span | None:
        """The place of `count` samples, the last of which was measured at `last_ns`.

        missing: how many are known to be lost before them; a jump of the time shows more. None
        for samples whose time is long over: they cannot be placed any more.
        """
        if self._origin_ns is None:
            self._origin_ns = last_ns - (count - 1) * self._nominal_ns
        error_ns = self._error_ns(count, missing, last_ns)
        if error_ns > JUMP_NS:
            missing += round(error_ns / self._period_ns)
            error_ns = self._error_ns(count, missing, last_ns)
        elif error_ns < -JUMP_NS:
            return None
        first_ns = self._next_ns + missing * self._period_ns
        self._next_ns = first_ns + self._follow(first_ns, count, error_ns)
        origin_ns = self._origin_ns
        return Span(origin_ns + round(first_ns), origin_ns + round(self._next_ns), missing)

    @property
    def rate_hz(self) -> float:
        """Samples a second, as measured."""
        return 1e9 / self._period_ns

    def _error_ns(self, count: int, missing: int, last_ns: int) -> float:
        assert self._origin_ns is not None
        predicted_ns = self._next_ns + (missing + count - 1) * self._period_ns
        return last_ns - self._origin_ns - predicted_ns

    def _follow(self, first_ns: float, count: int, error_ns: float) -> float:
        """Pull the period; how long the samples take, so that the next one's time is pulled too."""
        period_ns = self._period_ns
        end_ns = first_ns + count * period_ns
        # After a long packet that was pulled forward, a short one may end before it was to end.
        passed_ns = max(end_ns - self._measured_ns, period_ns)
        self._measured_ns = end_ns
        bandwidth_hz = max(BANDWIDTH_HZ, SETTLING * 1e9 / end_ns)
        omega = min(2 * math.pi * bandwidth_hz * passed_ns * 1e-9, LARGEST_OMEGA)
        pulled_ns = period_ns * (1 + omega * omega * error_ns / passed_ns)
        self._period_ns = _within(pulled_ns, LARGEST_RATE_ERROR, self._nominal_ns)
        step_ns = period_ns + math.sqrt(2) * omega * error_ns / count
        return count * _within(step_ns, LARGEST_STRETCH, period_ns)


def _within(value: float, share: float, of: float) -> float:
    """The value, or the nearest that differs from `of` by no more than a share of it."""
    return min(max(value, of * (1 - share)), of * (1 + share))
