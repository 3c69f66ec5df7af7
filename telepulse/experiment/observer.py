"""A simulated observer: feels force errors with a threshold of its own, and noise. Pure."""

from random import Random

from telepulse.experiment.psychometric import Errors

BEST_RATING = 5


class Observer:
    """Answers by the differencing strategy of `psychometric.py`.

    threshold: the difference in force error whose d' is 1, as a share of the pulse from peak to
    peak. Errors are given in the same unit. It feels errors aligned: a finger that only feels
    cannot know that a true pulse is late.
    """

    def __init__(self, threshold: float, seed: int) -> None:
        self._threshold = threshold
        self._random = Random(f"observer {seed}")

    def tell(self, errors: Errors) -> str:
        """What X is: "A" or "B"."""
        a, b, x = map(self._feel, errors)
        return "A" if abs(x - a) < abs(x - b) else "B"

    def rate(self, reference: float, x: float) -> int:
        """How close X is to the reference: 5 within a threshold, 4 within two, and so on to 1."""
        return max(1, BEST_RATING - int(abs(self._feel(x) - self._feel(reference))))

    def _feel(self, error: float) -> float:
        return error / self._threshold + self._random.gauss(0, 1)
