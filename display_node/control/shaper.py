"""Input shaper: a filter of the screw's path after which a rotor that rings comes to rest.

A step of the command is replaced by smaller ones whose swings cancel (Singer and Seering 1990).
All weights are positive and add up to 1, so a bound on the speed of the path before the shaper
also bounds the speed behind it (decision 35).
"""

import math

# The rotor's resonance may differ from the model's by this share of it.
TOLERANCE = 0.2
# From this damping ratio ζ on, a rotor's greatest speed is below 1.05 times its command's. With
# the overshoot K = exp(−π ζ / √(1 − ζ²)) this factor is (1 + K) / (1 − K).
NEVER_RINGS = 0.765
# Past positions are dropped when there are this many times more than needed.
KEEP = 10


def rotor_rings(resonance_hz: float, damping: float, tick_s: float) -> bool:
    """Return whether a shaper is of use: the rotor overshoots, and a tick can resolve its swing."""
    return damping < NEVER_RINGS and _half_period_ticks(resonance_hz, damping, tick_s) >= 1


def zero_vibration(resonance_hz: float, damping: float, tick_s: float) -> list[float]:
    """Return weights, one a tick, of steps after which a rotor is at rest.

    The first is at once, the others are at the two ticks around half a damped period later, where
    the sum of their swings is zero. Between ticks the command may be held or linear.

    Parameters
    ----------
    resonance_hz
        Undamped resonance in Hz. Half a damped period must be at least a tick.
    damping
        Damping ratio ζ, 0 to below 1.
    """
    whole = int(_half_period_ticks(resonance_hz, damping, tick_s))
    decay = 2 * math.pi * resonance_hz * tick_s * damping
    turn = 2 * math.pi * resonance_hz * tick_s * math.sqrt(1 - damping * damping)
    # The weights w at ticks t solve Σ w exp((decay + j turn) t) = 0.
    grown = math.exp(decay * whole)
    first = grown * math.exp(decay) * math.sin(turn)
    second = -math.exp(decay) * math.sin(turn * (whole + 1))
    third = math.sin(turn * whole)
    total = first + second + third
    return [first / total, *[0.0] * (whole - 1), second / total, third / total]


def shaper_weights(resonance_hz: float, damping: float, tick_s: float) -> list[float]:
    """Return the weights for a rotor whose resonance is known to ±20 %, one a tick.

    They have zeros at the resonance and at both ends of this range. Each step is divided into three
    within a sixth of the period, since the drive's acceleration limit would distort larger ones.
    """
    apart = max(1, round(1 / (12 * resonance_hz * tick_s)))
    weights = [1 / 3, *[0.0] * (apart - 1), 1 / 3, *[0.0] * (apart - 1), 1 / 3]
    for share in (1 / (1 + TOLERANCE), 1.0, 1 + TOLERANCE):
        if rotor_rings(share * resonance_hz, damping, tick_s):
            weights = _convolve(weights, zero_vibration(share * resonance_hz, damping, tick_s))
    return weights


class InputShaper:
    """A weighted mean of a path's last positions, behind a bound of the path's speed.

    Parameters
    ----------
    weights
        Weights of the positions, from the present one to the oldest; positive, with the sum 1.

    Attributes
    ----------
    delay_s
        Mean delay in s, weighted by the weights.
    spread_s2
        Variance of the delay in s².
    """

    def __init__(self, weights: list[float], tick_s: float) -> None:
        mean = sum(late * weight for late, weight in enumerate(weights))
        variance = sum(weight * (late - mean) ** 2 for late, weight in enumerate(weights))
        self.delay_s, self.spread_s2 = mean * tick_s, variance * tick_s**2
        # Weights that are not 0, with the age of their position in ticks.
        self._weights = [(weight, late) for late, weight in enumerate(weights) if weight]
        self._length = len(weights)
        self._past_m: list[float] = []

    def start(self, position_m: float) -> None:
        """Begin at rest at a position in m."""
        self._past_m = [position_m] * self._length

    def advance(self, position_m: float, most_m: float, ticks: int = 1) -> float:
        """Advance some ticks towards a position; return the shaped position in m.

        Parameters
        ----------
        position_m
            Position in m at the end of the ticks; reached later, if too far.
        most_m
            Greatest travel of a tick in m.
        ticks
            Number of ticks. In between, the path is straight.
        """
        past_m = self._past_m
        newest_m, kept = past_m[-1], min(ticks, self._length)
        most_m *= ticks / kept
        # In this order, NaN becomes the fastest way off the finger.
        travel_m = min(most_m, max(-most_m, (position_m - newest_m) / kept))
        for _ in range(kept):
            newest_m += travel_m
            past_m.append(newest_m)
        if len(past_m) > KEEP * self._length:
            del past_m[: -self._length]
        shaped_m = 0.0
        for weight, late in self._weights:
            shaped_m += weight * past_m[-1 - late]
        return shaped_m


def _half_period_ticks(resonance_hz: float, damping: float, tick_s: float) -> float:
    """Return half a damped period in ticks; infinite without a swing."""
    if damping >= 1:
        return math.inf
    return 1 / (2 * resonance_hz * math.sqrt(1 - damping * damping) * tick_s)


def _convolve(one: list[float], other: list[float]) -> list[float]:
    total = [0.0] * (len(one) + len(other) - 1)
    for later, share in enumerate(other):
        if share:
            for late, weight in enumerate(one, later):
                total[late] += weight * share
    return total
