"""A Butterworth low-pass, tick by tick: the filter behind a feedback film, and its model.

Exact for a signal that runs straight from tick to tick (first-order hold).

A delay line: what a value was some ticks ago, whole or not.
"""

import math
from collections import deque
from operator import mul
from typing import Any

import numpy as np


class DelayLine:
    """Gives back what it was given, `ticks` later; 0 before anything has come through.

    Between two ticks it runs straight, which is exact for a speed that is held for a tick and
    makes a step begin within one.
    """

    def __init__(self, ticks: float) -> None:
        whole = int(ticks)
        self._part = ticks - whole
        self._past: deque[float] = deque([0.0] * (whole + 2), whole + 2)

    def step(self, value: float) -> float:
        """Take this tick's value; the delayed one."""
        past = self._past
        past.append(value)
        return past[1] + self._part * (past[0] - past[1])

    def shift(self, change: float) -> None:
        """The newest value was so much more, as is known only now."""
        self._past[-1] += change


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
