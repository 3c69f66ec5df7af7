"""The paper's actuator model: g(s) = 1/(m s² + c s + k), from voltage to force (eq 22).

Integrated by the exact zero-order hold, a matrix exponential computed once.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from protocol.config.scene import Section


class SecondOrderScene(Section):
    """The `actuator` table of kind "second_order"; defaults are the paper's Table 4.

    The paper gives m in kg, c in N·s/m and k in N/m; with a force as output these cannot be
    its units, so they are plain numbers here. voltage_limit: none in the paper.
    """

    kind: Literal["second_order"]
    m: Annotated[float, Field(ge=1e-12, le=1e12)] = 0.65
    c: Annotated[float, Field(ge=0, le=1e12)] = 0.61
    k: Annotated[float, Field(ge=0, le=1e12)] = 4.23
    voltage_limit: Annotated[float, Field(gt=0)] = 1e6


class SecondOrder:
    """Steps eq 22 from tick to tick under a held voltage.

    matrix, shape (2, 3): force and its rate after a tick, from those before it and the voltage.
    """

    def __init__(self, scene: SecondOrderScene, tick_s: float) -> None:
        from scipy.linalg import expm

        m, c, k = scene.m, scene.c, scene.k
        system = np.array([[0, 1, 0], [-k / m, -c / m, 1 / m], [0, 0, 0]])
        held = expm(system * tick_s)
        self.matrix = held[:2]
        rows: list[list[float]] = self.matrix.tolist()
        (self._a11, self._a12, self._b1), (self._a21, self._a22, self._b2) = rows
        self._rate = 0.0
        self.force_n = 0.0

    @property
    def response(self) -> float:
        """Force in N at a tick's end for each volt held during it."""
        return self._b1

    def drift(self) -> float:
        """By how much the force changes in the next tick under no voltage, in N."""
        return (self._a11 - 1) * self.force_n + self._a12 * self._rate

    def step(self, volts: float) -> float:
        """Hold `volts` for one tick; the force in N at its end."""
        force_n, rate = self.force_n, self._rate
        self.force_n = self._a11 * force_n + self._a12 * rate + self._b1 * volts
        self._rate = self._a21 * force_n + self._a22 * rate + self._b2 * volts
        return self.force_n
