"""Beat analogues: what came after the moments of the last 40 s that were most like the present.

The distance of the present to every lag l is recursive,

    D(l) ← λ D(l) + (x(t) − x(t−l))² + w (ẋ(t) − ẋ(t−l))²,

and its lowest local minima are the analogues. After Lorenz (1969), analogues as predictors.
"""

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import AHEAD, HORIZONS, Trajectories
from display_node.prediction.history import History

LAGS = 8_000
# Nearer lags have no 250 ms after them, and are the present beat itself.
NEAREST = 60
MEMORIES_S = (0.05, 0.2, 0.6)
STEP_S = 0.005
# Weight of the slope (per step), about that of the signal: a pulse's power over its slope's.
SLOPE = 50.0
ANALOGUES = 15
# Kernel's width over the analogues' mean distance.
KERNEL = 0.2
# How much of the analogues' distance from the present value is taken off what followed them.
OFFSET = 0.5
# A lag counts once its distance has been summed for so long.
SETTLED = 160
ROWS = np.arange(len(MEMORIES_S))[:, np.newaxis]
TINY = 1e-30
# What follows an analogue, from the analogue itself on.
NEXT = np.concatenate([[0], AHEAD])


class Analogue:
    """Three trajectories, of a short, a middle and a long memory of the present."""

    names = tuple(f"analogue {memory_s:g} s" for memory_s in MEMORIES_S)
    trust = 0.2

    def __init__(self) -> None:
        # Oldest first, like the history: index i is the lag LAGS − i.
        self._difference = np.zeros(LAGS)
        self._step = np.zeros(LAGS)
        self._distances = np.zeros((len(MEMORIES_S), LAGS))
        self._places = np.zeros((0, ANALOGUES), np.intp)
        self._forget = np.exp(-STEP_S / np.array(MEMORIES_S))[:, np.newaxis]

    def observe(self, history: History) -> None:
        """Carry the distances on and find the analogues."""
        self._advance(history.last(LAGS + 1))
        first = LAGS - min(LAGS, history.count - SETTLED)
        self._places = np.zeros((0, ANALOGUES), np.intp)
        if first < LAGS - NEAREST - 2:
            reached = self._distances[:, first : LAGS - NEAREST + 1]
            places = [_lowest_minima(distances) for distances in reached]
            if all(map(len, places)):
                self._places = first + np.array(places)

    def predict(self, history: History) -> Trajectories:
        """A trajectory a memory (`Expert`)."""
        if not len(self._places):
            return np.zeros((len(MEMORIES_S), HORIZONS))
        return self._follow(history.last(LAGS + 1), self._places)

    def _advance(self, past: NDArray[np.float64]) -> None:
        # The slope's difference is the difference's step: x and its lagged self move on together.
        difference, step = self._step, self._difference
        np.subtract(past[:-1], past[-1], out=difference)
        step -= difference
        self._difference, self._step = difference, step
        step *= step
        step *= SLOPE
        step += difference * difference
        self._distances *= self._forget
        self._distances += step

    def _follow(self, past: NDArray[np.float64], places: NDArray[np.intp]) -> Trajectories:
        """What followed the analogues at places of shape (memories, analogues)."""
        nearest = self._distances[ROWS, places]
        width = KERNEL / ANALOGUES * nearest.sum(axis=1, keepdims=True) + TINY
        weights = np.exp((nearest.min(axis=1, keepdims=True) - nearest) / width)
        weights /= weights.sum(axis=1, keepdims=True)
        followed = np.einsum("mi,mih->mh", weights, past[places[:, :, np.newaxis] + NEXT])
        followed -= past[-1]
        return np.asarray(followed[:, 1:] - OFFSET * followed[:, :1])


def _lowest_minima(distances: NDArray[np.float64]) -> NDArray[np.intp]:
    """Where the lowest local minima are, ANALOGUES of them: few repeat; empty without any."""
    middle = distances[1:-1]
    at = np.flatnonzero((middle < distances[:-2]) & (middle <= distances[2:]))
    if len(at) > ANALOGUES:
        at = at[middle[at].argpartition(ANALOGUES)[:ANALOGUES]]
    elif len(at):
        at = np.resize(at, ANALOGUES)
    return at + 1
