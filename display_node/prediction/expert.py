"""Common horizons of the experts, and their interface.

An expert predicts a history's values at `HORIZONS` horizons up to 250 ms ahead: of its first
channel, and from the same past of that channel those of the others, which are the same pulse at
other places. The package's docstring lists the places to change when you add one.
"""

from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.history import History

# The horizons are 10 ms apart, up to 250 ms, and a cubic joins them: the pulse ends below 40 Hz.
SPACING: Final = 2
HORIZONS: Final = 25
FURTHEST: Final = SPACING * HORIZONS
AHEAD = SPACING * np.arange(1, HORIZONS + 1)
Floats = NDArray[np.float64]


class Expert(Protocol):
    """Predictor of a history's values `AHEAD` steps after the newest, as one or more trajectories.

    names: of its trajectories. trust: weight of each of them at the stack's start.
    """

    names: tuple[str, ...]
    trust: tuple[float, ...]

    def predict(self, history: History, made: Floats) -> None:
        """Write the predicted differences from the newest values, shape (names, channels, 25).

        Zeros, which hold the newest value, mean that the expert has not learnt enough.
        """

    def learn(self, history: History, artefact: bool = False) -> None:
        """Learn what outlasts the moment; call it after `predict` at steps of learning.

        They are at least `SPACING` steps apart. artefact: whether one is present, from which
        nothing is learnt.
        """
        return

    def prepare(self, history: History) -> None:
        """Prepare the next predictions; call it after `predict` at every step."""
        return
