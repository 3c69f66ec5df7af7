"""A finger that presses a display, for simulation: a commanded force, a stiffness, a sensor. Pure."""

import math

import numpy as np

from protocol.tissue import StiffeningLaw

# A hand that meets another tissue than it expects returns to the force that it means.
ADAPTS_S = 0.5


class PressingFinger:
    """A finger that means to press with a force, and the sensor behind the tip.

    The hand yields with the tissue that it expects. Where the tip yields otherwise, the hand's
    stiffness changes the force until the hand has adapted.

    Parameters
    ----------
    stiffness_n_per_m
        Stiffness of finger and hand.
    pulse_share
        Share of the rendered pulse that the sensor reads: 1 for a pulse controlled in force; for
        one that is a motion, the finger's stiffness over the assumed one.
    yield_s
        Time constant with which the hand expects the tissue to yield.
    noise_n
        Standard deviation of the sensor's noise.
    """

    def __init__(
        self,
        stiffness_n_per_m: float = 500.0,
        pulse_share: float = 1.0,
        yield_s: float = 0.25,
        noise_n: float = 2e-3,
        seed: int = 1,
    ) -> None:
        self._stiffness_n_per_m = stiffness_n_per_m
        self._pulse_share = pulse_share
        self._yield_s = yield_s
        self._noise_n = noise_n
        self._rng = np.random.default_rng(seed)
        self._expected = StiffeningLaw()
        self._expected_m = self._adapted_m = 0.0
        self.press_n = 0.0

    def step(self, meant_n: float, yielded_m: float, pulse_n: float, elapsed_s: float) -> float:
        """Advance, and return the sensor's reading in N; `press_n` is the true static force.

        Parameters
        ----------
        meant_n
            Force with which the hand means to press.
        yielded_m
            Distance by which the tip has yielded.
        pulse_n
            Pulse that the tip renders.
        """
        follows = -math.expm1(-elapsed_s / self._yield_s)
        self._expected_m += (self._expected.depth_m(meant_n) - self._expected_m) * follows
        unexpected_m = self._expected_m + self._adapted_m - yielded_m
        self._adapted_m -= unexpected_m * -math.expm1(-elapsed_s / ADAPTS_S)
        self.press_n = max(0.0, meant_n + self._stiffness_n_per_m * unexpected_m)
        if self.press_n == 0.0:
            return self._noise_n * float(self._rng.standard_normal())
        noise_n = self._noise_n * float(self._rng.standard_normal())
        return self.press_n + self._pulse_share * pulse_n + noise_n
