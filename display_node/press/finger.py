"""A finger that presses a display, for simulation: its force, stiffness and sensor. Pure."""

import math

import numpy as np

# The hand follows a tip that yields with this time constant; faster motions meet its stiffness.
FOLLOWS_S = 0.1


class PressingFinger:
    """A finger that means to press with a force, and the sensor behind the tip.

    The hand follows the tip to keep the force that it means. While the tip yields faster, the
    hand's stiffness lowers the force.

    Parameters
    ----------
    stiffness_n_per_m
        Stiffness of finger and hand.
    pulse_share
        Share of the rendered pulse that the sensor reads: 1 for a pulse controlled in force; for
        one that is a motion, the finger's stiffness over the assumed one.
    noise_n
        Standard deviation of the sensor's noise.
    """

    def __init__(
        self,
        stiffness_n_per_m: float = 300.0,
        pulse_share: float = 1.0,
        noise_n: float = 2e-3,
        seed: int = 1,
    ) -> None:
        self._stiffness_n_per_m = stiffness_n_per_m
        self._pulse_share = pulse_share
        self._noise_n = noise_n
        self._rng = np.random.default_rng(seed)
        self._followed_m = 0.0
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
        lag_m = self._followed_m - yielded_m
        self._followed_m -= lag_m * -math.expm1(-elapsed_s / FOLLOWS_S)
        self.press_n = max(0.0, meant_n + self._stiffness_n_per_m * lag_m)
        noise_n = self._noise_n * float(self._rng.standard_normal())
        touched = self._pulse_share * pulse_n if self.press_n else 0.0
        return self.press_n + touched + noise_n
