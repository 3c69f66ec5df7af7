"""A Butterworth low-pass, tick by tick: the filter behind a feedback film, and its model.

Exact for a signal that runs straight from tick to tick (first-order hold).
"""

import math
from operator import mul
from typing import Any

import numpy as np


class LowPass:
    """Low-pass of `order` poles at `corner_hz`; starts at rest.

    The output at a tick needs the input at that tick, so reading and moving on are two calls.
    """

    def __init__(self, corner_hz: float, order: int, tick_s: float) -> None:
        from scipy.signal import butter, cont2discrete, zpk2ss

        zeros, poles, gain = butter(order, 2 * math.pi * corner_hz, analog=True, output="zpk")
        analog: Any = zpk2ss(zeros, poles, gain)
        a, b, c, d = cont2discrete(analog, tick_s, method="foh")[:4]
        self.a, self.b, self.c, self.d = a, b, c, d
        self._rows = [(row, into) for row, into in zip(a.tolist(), b[:, 0].tolist(), strict=True)]
        self._out: list[float] = c[0].tolist()
        self._through = float(d[0, 0])
        self._at_one: list[float] = np.linalg.solve(np.eye(order) - a, b[:, 0]).tolist()
        self._state = [0.0] * order

    def settle(self, value: float) -> None:
        """Be as after an endless time of `value`."""
        self._state = [share * value for share in self._at_one]

    def output(self, value: float) -> float:
        """What the filter gives at this tick, when its input is `value`."""
        total = self._through * value
        for share, state in zip(self._out, self._state, strict=True):
            total += share * state
        return total

    def advance(self, value: float) -> None:
        """Go on to the next tick."""
        state = self._state
        self._state = [sum(map(mul, row, state)) + into * value for row, into in self._rows]

    def correct(self, shares: list[float], error: float) -> None:
        """Move the state by `shares` of an error of its output (an observer's correction)."""
        self._state = [
            state + share * error for state, share in zip(self._state, shares, strict=True)
        ]
