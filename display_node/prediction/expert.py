"""What every expert of the stack is: predictions over a common row of horizons."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.history import History

# Every 10 ms up to 250 ms: the pulse ends below 40 Hz, and a cubic joins them.
SPACING, HORIZONS = 2, 25
AHEAD = SPACING * np.arange(1, HORIZONS + 1)
FURTHEST = SPACING * HORIZONS
Trajectories = NDArray[np.float64]


class Expert(Protocol):
    """Predicts a history's values `AHEAD` steps after the newest, in one or several ways.

    names: of its predictions; trust: the weight each has before the stack has learnt.
    """

    names: tuple[str, ...]
    trust: float

    def observe(self, history: History) -> None:
        """A value was pushed; call once after each push."""

    def predict(self, history: History) -> Trajectories:
        """After `observe`: differences of those values from the newest, shape (names, 25).

        Zeros, which is to hold the newest, for as long as the expert knows nothing better.
        """

    def learn(self, history: History) -> None:
        """After `predict`: what of the work on the newest value can wait until then."""
