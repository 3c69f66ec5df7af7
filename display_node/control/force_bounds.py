"""Limits of the force targets, independent of what the peer sends."""

import math
from typing import Final

from display_node.control.scene import SafetyScene
from display_node.plant.film_plausibility import FilmFault
from protocol.faults import Fault
from protocol.ticks import LimitCounter

# A reference below 0 N by less than this is rounding and noise, not a part of the pulse.
NEGLIGIBLE_N: Final = 1e-3


class ForceBounds:
    """Bounds of one contactor's reference, tick by tick.

    Attributes
    ----------
    at_force_limit, below_zero, at_slew_limit
        How often and for how long each bound was in effect. The slew limit is not counted in ramps
        and fades, where it is intended.
    """

    def __init__(self, scene: SafetyScene, tick_ns: int) -> None:
        self._limit_n = scene.force_limit_n
        self._slew_n = scene.slew_limit_n_per_s * tick_ns * 1e-9
        self._overforce_n = scene.overforce_n
        self._last_n = 0.0
        # Whether a bound was in effect in the last tick.
        self._bounds = False
        self.at_force_limit, self.below_zero = LimitCounter(), LimitCounter()
        self.at_slew_limit = LimitCounter()

    @property
    def counters(self) -> dict[str, LimitCounter]:
        """Counters of the bounds, by their names in `Limits`."""
        return {
            "force": self.at_force_limit,
            "negative": self.below_zero,
            "slew": self.at_slew_limit,
        }

    def reading_fault(self, feedback_n: float, now_ns: int) -> Fault | None:
        """Return the fault of a reading of the felt force in N that is implausible, or None."""
        if -self._overforce_n <= feedback_n <= self._overforce_n:
            return None
        if not math.isfinite(feedback_n):
            return FilmFault.NOT_A_NUMBER.at(now_ns)
        return FilmFault.OVERFORCE.at(now_ns, limit=self._overforce_n)

    def bound(self, reference_n: list[float], gain: float) -> list[float]:
        """Return the reference within force and slew limits, in N.

        Parameters
        ----------
        reference_n
            Reference force now and in the next ticks, in N.
        gain
            Factor of the reference, 0 to 1.
        """
        # Comparisons, and no calls of `min` and `max`: this runs each tick.
        limit_n, slew_n, last_n = self._limit_n, self._slew_n, self._last_n
        bounded = []
        for force_n in reference_n:
            within_n = gain * force_n
            # NaN (two enormous samples overflow) becomes 0 N.
            if not within_n > 0.0:
                within_n = 0.0
            elif within_n > limit_n:
                within_n = limit_n
            if within_n > last_n + slew_n:
                last_n += slew_n
            elif within_n < last_n - slew_n:
                last_n -= slew_n
            else:
                last_n = within_n
            bounded.append(last_n)
        wanted_n = gain * reference_n[0]
        self._last_n = last_n = bounded[0]
        if last_n == wanted_n and not self._bounds:
            return bounded
        above, below = wanted_n > limit_n, not wanted_n >= -NEGLIGIBLE_N
        within_n = limit_n if above else wanted_n if wanted_n > 0.0 else 0.0
        slewing = gain == 1.0 and last_n != within_n
        if above or self.at_force_limit.active:
            self.at_force_limit.add(above)
        if below or self.below_zero.active:
            self.below_zero.add(below)
        if slewing or self.at_slew_limit.active:
            self.at_slew_limit.add(slewing)
        self._bounds = above or below or slewing
        return bounded
