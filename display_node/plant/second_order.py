"""The actuator model of Dargahi et al. (2008): g(s) = 1/(m s² + c s + k), voltage to force (eq 22).

It is integrated exactly for a held voltage, by a matrix exponential that is computed once.
"""

from typing import ClassVar

import numpy as np

from display_node.plant.scene import SecondOrderScene


class SecondOrder:
    """Eq 22 from tick to tick, with the voltage held constant during each tick.

    Attributes
    ----------
    force_n
        Force in N at the last tick's end.
    """

    STATE: ClassVar = ("force_n", "_rate")

    def __init__(self, scene: SecondOrderScene, tick_s: float) -> None:
        from scipy.linalg import expm

        m, c, k = scene.m, scene.c, scene.k
        system = np.array([[0, 1, 0], [-k / m, -c / m, 1 / m], [0, 0, 0]])
        held = expm(system * tick_s)
        rows: list[list[float]] = held[:2].tolist()
        (self._a11, self._a12, self._b1), (self._a21, self._a22, self._b2) = rows
        self._rate = 0.0
        self.force_n = 0.0

    @property
    def response(self) -> float:
        """Force in N at a tick's end for each volt held during it."""
        return self._b1

    def place(self, force_n: float) -> None:
        """Set the state to a force in N, at rest."""
        self.force_n, self._rate = force_n, 0.0

    def drift(self) -> float:
        """Return the force's change in N in the next tick without a voltage."""
        return (self._a11 - 1) * self.force_n + self._a12 * self._rate

    def step(self, volts: float) -> float:
        """Hold a voltage in V for one tick and return the force in N at its end."""
        force_n, rate = self.force_n, self._rate
        self.force_n = self._a11 * force_n + self._a12 * rate + self._b1 * volts
        self._rate = self._a21 * force_n + self._a22 * rate + self._b2 * volts
        return self.force_n
