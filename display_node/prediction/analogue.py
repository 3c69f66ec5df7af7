"""Beat analogues: what came after the moments of the last 40 s that were most like the present.

The distance of the present to every lag l is recursive,

    D(l) ← λ D(l) + (x(t) − x(t−l))² + w (ẋ(t) − ẋ(t−l))²,

and its lowest local minima are the analogues. After Lorenz (1969), analogues as predictors.
"""

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import AHEAD, HORIZONS, History, Trajectories

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
        # Oldest first, like the history: index i is the lag LAGS − i. Single precision: these are
        # the longest rows of all, and what is in them is noisier than it is coarse.
        self._difference = np.zeros(LAGS, np.float32)
        self._step = np.zeros(LAGS, np.float32)
        self._distances = np.zeros((len(MEMORIES_S), LAGS), np.float32)
        self._places: NDArray[np.intp] | None = None
        self._forget = np.exp(-STEP_S / np.array(MEMORIES_S, np.float32))[:, np.newaxis]

    def observe(self, history: History) -> None:
        """Carry the distances on and find the analogues."""
        past = history.last(LAGS + 1)
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
        first = LAGS - min(LAGS, history.count - SETTLED)
        self._places = None
        if first < LAGS - NEAREST - 2:
            places = _lowest_minima(self._distances[:, first : LAGS - NEAREST + 1])
            self._places = None if places is None else first + places

    def predict(self, history: History) -> Trajectories:
        """Return a trajectory for each memory (`Expert`)."""
        if self._places is None:
            return np.zeros((len(MEMORIES_S), HORIZONS))
        return self._follow(history.last(LAGS + 1), self._places)

    def learn(self, history: History) -> None:
        """There is nothing more."""

    def _follow(self, past: NDArray[np.float32], places: NDArray[np.intp]) -> Trajectories:
        """Return what followed the analogues at places of shape (memories, analogues)."""
        nearest = self._distances[ROWS, places]
        width = KERNEL / ANALOGUES * np.add.reduce(nearest, axis=1, keepdims=True) + TINY
        weights = np.exp((np.minimum.reduce(nearest, axis=1, keepdims=True) - nearest) / width)
        weights /= np.add.reduce(weights, axis=1, keepdims=True)
        ahead = past.take(places[:, :, np.newaxis] + NEXT)
        followed = (weights[:, np.newaxis] @ ahead)[:, 0] - past[-1]
        return np.asarray(followed[:, 1:] - OFFSET * followed[:, :1], np.float64)


def _lowest_minima(distances: NDArray[np.float32]) -> NDArray[np.intp] | None:
    """Where each row's lowest local minima are, ANALOGUES of them: few repeat; None without any."""
    middle = distances[:, 1:-1]
    is_lowest = middle < distances[:, :-2]
    is_lowest &= middle <= distances[:, 2:]
    places = np.empty((len(distances), ANALOGUES), np.intp)
    for row, chosen in enumerate(is_lowest):
        (at,) = chosen.nonzero()
        if len(at) > ANALOGUES:
            at = at[middle[row, at].argpartition(ANALOGUES)[:ANALOGUES]]
        elif not len(at):
            return None
        places[row] = np.resize(at, ANALOGUES) if len(at) < ANALOGUES else at
    places += 1
    return places
