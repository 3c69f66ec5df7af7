"""Discrete filters of the loop: a delay line of any length, and a Butterworth low-pass."""

import math
from collections import deque
from operator import mul
from typing import Any, ClassVar


class DelayLine:
    """Delay of a sampled value; the output is 0 until the first value has passed.

    Between two ticks the value is interpolated linearly, which is exact for the integral of a speed
    that is held for a tick.

    Parameters
    ----------
    ticks
        Delay in ticks, above 0, not necessarily whole.
    """

    STATE: ClassVar = ("_past",)

    def __init__(self, ticks: float) -> None:
        whole = int(ticks)
        self._part = ticks - whole
        self._past: deque[float] = deque([0.0] * (whole + 2), whole + 2)

    def step(self, value: float) -> float:
        """Take this tick's value and return the delayed one."""
        past = self._past
        past.append(value)
        return past[1] + self._part * (past[0] - past[1])

    def shift(self, change: float) -> None:
        """Add a change, known only after `step`, to the newest value."""
        self._past[-1] += change


def delay_line(ticks: float) -> DelayLine | None:
    """Return a delay line; None for no delay, whose poles at 0 a linear model would keep."""
    return DelayLine(ticks) if ticks else None


class LowPass:
    """Butterworth low-pass, exact for a signal that is linear between ticks.

    `output` and `advance` are two calls, as an observer needs a tick's output before it corrects
    the state. The matrices a, b, c and d are those of the first-order hold.

    Parameters
    ----------
    corner_hz
        Corner frequency in Hz.
    order
        Number of poles.
    """

    STATE: ClassVar = ("_state",)

    def __init__(self, corner_hz: float, order: int, tick_s: float) -> None:
        from scipy.signal import butter, cont2discrete, zpk2ss

        zeros, poles, gain = butter(order, 2 * math.pi * corner_hz, analog=True, output="zpk")
        analog: Any = zpk2ss(zeros, poles, gain)
        a, b, c, d = cont2discrete(analog, tick_s, method="foh")[:4]
        self.a, self.b, self.c, self.d = a, b, c, d
        self._rows = [(row, into) for row, into in zip(a.tolist(), b[:, 0].tolist(), strict=True)]
        self._out: list[float] = c[0].tolist()
        self._through = float(d[0, 0])
        self._state = [0.0] * order

    def output(self, value: float) -> float:
        """Return the output at this tick for its input."""
        total = self._through * value
        for share, state in zip(self._out, self._state, strict=True):
            total += share * state
        return total

    def advance(self, value: float) -> None:
        """Advance the state to the next tick, from this tick's input."""
        state = self._state
        self._state = [sum(map(mul, row, state)) + into * value for row, into in self._rows]

    def correct(self, changes: list[float]) -> None:
        """Add an observer's correction to the state."""
        self._state = [state + change for state, change in zip(self._state, changes, strict=True)]
