"""Observer that answers blinded trials, to try a session or to estimate the number of trials.

Its percept of an interval is one number: the force error in units of its threshold, plus noise of
standard deviation 1. In an ABX trial X is identified as the nearer one of A and B: the differencing
strategy of Macmillan and Creelman, *Detection Theory*, ch. 9. At the threshold, d' is 1.
"""

from random import Random
from typing import Literal


class SimulatedObserver:
    """Observer that answers by the differencing strategy.

    threshold: the difference in force error whose d' is 1, as a share of the pulse from peak to
    peak. Errors have the same unit. They are the aligned ones, because a finger alone cannot detect
    a delay.
    """

    def __init__(self, threshold: float, seed: int) -> None:
        self._threshold = threshold
        self._random = Random(f"observer {seed}")

    def identify(self, a: float, b: float, x: float) -> Literal["A", "B"]:
        """Return "A" or "B" for X, from the errors of A, B and X."""
        a, b, x = map(self._feel, (a, b, x))
        return "A" if abs(x - a) < abs(x - b) else "B"

    def rate(self, reference: float, x: float) -> Literal[1, 2, 3, 4, 5]:
        """Return the rating of X: 5 within 1 threshold of the reference, 4 within 2, down to 1."""
        apart = int(abs(self._feel(x) - self._feel(reference)))
        ratings: tuple[Literal[5, 4, 3, 2, 1], ...] = (5, 4, 3, 2, 1)
        return ratings[min(apart, 4)]

    def _feel(self, error: float) -> float:
        return error / self._threshold + self._random.gauss(0, 1)
