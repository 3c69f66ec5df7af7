"""A delay line: what a value was some ticks ago, whole or not."""

from collections import deque


class Delay:
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
