"""Soft limits: how fast the tip may go so that it can still stop before the end of its travel."""

import math


class SoftLimits:
    """The part of the travel that may be used, and the speed that it leaves.

    lowest_m, furthest_m: ends of the travel from first touch. reaction_s: time from a command
    to what it does, beside the age of the position it is judged by.
    """

    def __init__(
        self, lowest_m: float, furthest_m: float, acceleration_m_per_s2: float, reaction_s: float
    ) -> None:
        self._lowest_m = lowest_m
        self._furthest_m = furthest_m
        self._acceleration = acceleration_m_per_s2
        self._reaction_s = reaction_s

    def bound(self, speed_m_per_s: float, position_m: float, age_s: float) -> float:
        """The wanted speed, or what is left of it near an end; 0 for no number.

        position_m was true age_s ago. Until the drive reacts the tip may go on at the full
        speed v, then it brakes: v t + v²/2a must not exceed the distance that is left. Since the
        position was heard the tip may have been faster than v, but not twice as fast: speeds so
        bounded fall by no more than a factor of e in a time of t, which is twice the age or more.
        """
        if speed_m_per_s > 0:
            return min(speed_m_per_s, self._fastest(self._furthest_m - position_m, age_s))
        if speed_m_per_s < 0:
            return -min(-speed_m_per_s, self._fastest(position_m - self._lowest_m, age_s))
        return 0.0

    def _fastest(self, distance_m: float, age_s: float) -> float:
        if not distance_m > 0:
            return 0.0
        blind_s, braking = 2 * age_s + self._reaction_s, self._acceleration
        return braking * (math.sqrt(blind_s * blind_s + 2 * distance_m / braking) - blind_s)
