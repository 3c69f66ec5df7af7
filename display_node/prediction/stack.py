"""Combination of trajectories by least squares."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import HORIZONS, SPACING, Floats
from display_node.prediction.history import NEVER, History
from display_node.prediction.kernels import CUBE, FLOATS, ROWS, TABLE, kernel
from display_node.prediction.ridge import solve_ridge

# Memory of the weights, in steps of learning: it grows by half a step a step, so that what the
# experts predicted before they had learnt is soon forgotten.
FIRST_MEMORY_STEPS, MEMORY_STEPS = 30, 2_000
# Steps of learning over which the level of the errors is averaged, about a beat.
LEVEL_STEPS: Final = 100
# An error counts as its square over the level, up to this; beyond, its weight falls as it grows.
LARGEST: Final = 20.0
# A level of 0.1 % of the deviation is as good as none.
LEAST_LEVEL: Final = 1e-6
# Strength of the initial weights, in steps with errors of the level.
RIDGE: Final = 30.0
# Least strength, over the largest product.
LEAST_RIDGE: Final = 1e-9
# The weights are computed anew after this number of steps, some 60 ms.
SOLVED = 5


@kernel(f"void({TABLE}, {CUBE}, {FLOATS}, {TABLE})")
def combine(weights: Floats, trajectories: Floats, newest: Floats, paths: Floats) -> None:
    """Write each channel's path: its newest value plus the weighted trajectories.

    weights: shape (n, 25). trajectories: shape (n, channels, 25).
    """
    for channel in range(len(paths)):
        path = paths[channel]
        path[:] = newest[channel]
        for number in range(len(weights)):
            for horizon in range(HORIZONS):
                path[horizon] += weights[number, horizon] * trajectories[number, channel, horizon]


@kernel(f"void({CUBE}, {FLOATS}, {TABLE}, {ROWS}, int64, float64)")
def add_products(
    products: Floats,
    levels: Floats,
    made: Floats,
    rows: NDArray[np.float32],
    first: int,
    forget: float,
) -> None:
    """Add the products of trajectories with each other and the values that have come since.

    products: of each horizon, shape (25, n, n + 1). levels: of the least squared errors at each
    horizon. made: shape (n, 25). first: place of the value that the trajectories begin at.
    """
    count, row = len(made), rows[0]
    for horizon in range(HORIZONS):
        came = row[first + SPACING * (horizon + 1)] - row[first]
        least = (made[0, horizon] - came) ** 2
        for number in range(1, count):
            least = min(least, (made[number, horizon] - came) ** 2)
        level = max(levels[horizon], LEAST_LEVEL)
        share = 1.0 / max(level, least / LARGEST)
        levels[horizon] = level + (min(least, LARGEST * level) - level) / LEVEL_STEPS
        for number in range(count):
            left = share * made[number, horizon]
            sums = products[horizon, number]
            for other in range(count):
                sums[other] = sums[other] * forget + left * made[other, horizon]
            sums[count] = sums[count] * forget + left * came


@kernel(f"boolean({CUBE}, {FLOATS}, float64, {TABLE})")
def solve_weights(products: Floats, trust: Floats, ridge: float, weights: Floats) -> bool:
    """Write the weights of least squared error at each horizon, with a ridge towards `trust`.

    Returns False, and leaves the weights of a horizon, where there are none.
    """
    count = len(trust)
    # After an enormous sample, the ridge is more than the products' rounding.
    ridge = max(ridge, LEAST_RIDGE * products.max())
    squares, solved = np.empty((count, count)), np.empty((count, 1))
    complete = True
    for horizon in range(HORIZONS):
        for number in range(count):
            for other in range(count):
                squares[number, other] = products[horizon, number, other]
            squares[number, number] += ridge
            solved[number, 0] = products[horizon, number, count] + ridge * trust[number]
        if solve_ridge(squares, solved):
            for number in range(count):
                weights[number, horizon] = solved[number, 0]
        else:
            complete = False
    return complete


class Stack:
    """Combination of n trajectories, with least-squares weights for every horizon.

    A trajectory is used when the values at all its horizons have come. trust: initial weights,
    shape (n,).

    A squared error counts over the level of the errors at its time: those of the least wrong
    trajectory over the last beat. Otherwise a rare beat that none of them predicts, or the time
    before they had learnt, would choose the weights for as long as they are remembered.
    """

    def __init__(self, trust: Floats) -> None:
        count = len(trust)
        self._trust = np.asarray(trust, np.float64)
        self._weights = np.repeat(self._trust[:, np.newaxis], HORIZONS, axis=1)
        # For each horizon, the trajectories' products with each other and with the true values.
        self._products = np.zeros((HORIZONS, count, count + 1))
        self._levels = np.ones(HORIZONS)
        # The trajectories of the last steps of learning, and the history's count at them.
        self._made = np.zeros((HORIZONS, count, HORIZONS))
        self._counts = [NEVER] * HORIZONS
        self._trajectories = np.zeros((count, HORIZONS))
        self._steps = 0

    def predict(self, newest: Floats, trajectories: Floats, paths: Floats) -> None:
        """Combine trajectories into paths of shape (channels, 25).

        newest: newest value of each channel, shape (channels,). trajectories: shape (n, channels,
        25). The weights are learnt from the first channel.
        """
        self._trajectories = trajectories[:, 0]
        combine(self._weights, trajectories, newest, paths)

    def learn(self, history: History, artefact: bool = False) -> None:
        """Learn from the oldest trajectories, and store the newest ones in their place.

        artefact: whether one is present; the weights are then kept. Call it after `predict`, at
        steps of learning.
        """
        place = self._steps % HORIZONS
        made, first = self._made[place], history.place_of(self._counts[place])
        self._steps += 1
        if first >= 0 and not artefact:
            forget = 1 - 1 / min(MEMORY_STEPS, FIRST_MEMORY_STEPS + self._steps / 2)
            add_products(self._products, self._levels, made, history.buffer, first, forget)
            if self._steps % SOLVED == 0:
                solve_weights(self._products, self._trust, RIDGE, self._weights)
        made[:] = self._trajectories
        self._counts[place] = NEVER if artefact else history.count
