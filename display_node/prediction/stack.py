"""Combination of trajectories by least squares."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import HORIZONS, SPACING, Floats
from display_node.prediction.history import NEVER, History
from display_node.prediction.kernels import CUBE, FLOATS, ROWS, TABLE, kernel
from display_node.prediction.ridge import solve_ridge

# Members that the stack has beside the experts' trajectories: the signal at the end of the newest
# cell, and a cell later; and its own paths of some steps ago.
ENDS: Final = 2
AGES = (2, 4)
OWN: Final = 4
# Paths that are kept.
KEPT: Final = 4
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
# Strength for the stack's own members, over that of the initial weights: they are nearly the same
# as others, and learnt sooner with less than all errors.
OWN_RIDGE: Final = 40.0
# Least strength, over the largest product.
LEAST_RIDGE: Final = 1e-9
# The weights are computed anew after this number of steps, some 60 ms.
SOLVED = 5


@kernel(f"void({TABLE}, {CUBE}, {FLOATS}, {TABLE}, {CUBE}, int64, {TABLE}, {TABLE})")
def combine(
    weights: Floats,
    trajectories: Floats,
    newest: Floats,
    ahead: Floats,
    earlier: Floats,
    count: int,
    members: Floats,
    paths: Floats,
) -> None:
    """Write each channel's path: its newest value plus the weighted members.

    weights: shape (n + `OWN`, 25). trajectories: of the experts, shape (n, channels, 25). newest,
    ahead: of each channel, as in `History`. earlier: the last paths, of `count` so far, shape
    (`KEPT`, channels, 25); the oldest is replaced. members: where to write those of the first
    channel, shape (n + `OWN`, 25).
    """
    experts = len(trajectories)
    for channel in range(len(paths)):
        path, value = paths[channel], newest[channel]
        own = members[experts:] if channel == 0 else np.empty((OWN, HORIZONS))
        for number in range(ENDS):
            own[number, :] = ahead[channel, number] - value
        for number in range(len(AGES)):
            age, moved = AGES[number], AGES[number] // SPACING
            made, member = earlier[(count - age) % KEPT, channel], own[ENDS + number]
            for horizon in range(HORIZONS):
                # A path ends 250 ms after it was made.
                then = made[min(horizon + moved, HORIZONS - 1)]
                member[horizon] = then - value if count >= age else 0.0
        path[:] = value
        for number in range(experts):
            for horizon in range(HORIZONS):
                path[horizon] += weights[number, horizon] * trajectories[number, channel, horizon]
        for number in range(OWN):
            for horizon in range(HORIZONS):
                path[horizon] += weights[experts + number, horizon] * own[number, horizon]
    for number in range(experts):
        members[number] = trajectories[number, 0]
    earlier[count % KEPT] = paths


@kernel(f"void({CUBE}, {FLOATS}, {TABLE}, {ROWS}, int64, float64)")
def add_products(
    products: Floats,
    levels: Floats,
    made: Floats,
    rows: NDArray[np.float32],
    first: int,
    forget: float,
) -> None:
    """Add the products of members with each other and the values that have come since.

    products: of each horizon, shape (25, n, n + 1), of which the lower triangle and the last column
    count. levels: of the least squared errors of the experts at each horizon. made: shape (n, 25).
    first: place of the value that the members begin at.
    """
    count, row = len(made), rows[0]
    experts = count - OWN
    for horizon in range(HORIZONS):
        came = row[first + SPACING * (horizon + 1)] - row[first]
        least = (made[0, horizon] - came) ** 2
        for number in range(1, experts):
            least = min(least, (made[number, horizon] - came) ** 2)
        level = max(levels[horizon], LEAST_LEVEL)
        share = 1.0 / max(level, least / LARGEST)
        levels[horizon] = level + (min(least, LARGEST * level) - level) / LEVEL_STEPS
        for number in range(count):
            left = share * made[number, horizon]
            sums = products[horizon, number]
            for other in range(number + 1):
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
            for other in range(number + 1):
                squares[number, other] = products[horizon, number, other]
            strength = ridge if number < count - OWN else ridge * OWN_RIDGE
            squares[number, number] += strength
            solved[number, 0] = products[horizon, number, count] + strength * trust[number]
        if solve_ridge(squares, solved):
            for number in range(count):
                weights[number, horizon] = solved[number, 0]
        else:
            complete = False
    return complete


class Stack:
    """Combination of trajectories, with least-squares weights for every horizon.

    Its members are the n trajectories of the experts, and `OWN` of its own: the signal at the end
    of the newest cell, and a cell later, which are nearer to the newest sample than the cell's mean
    is; and its own paths of 10 and 20 ms ago, which have less of the newest cell's noise, and show
    how far they were wrong until now.

    A member is used when the values at all its horizons have come. trust: initial weights of the
    experts' trajectories, shape (n,).

    A squared error counts over the level of the errors at its time: those of the least wrong
    trajectory over the last beat. Otherwise a rare beat that none of them predicts, or the time
    before they had learnt, would choose the weights for as long as they are remembered.
    """

    def __init__(self, trust: Floats, channels: int = 1) -> None:
        self._trust = np.concatenate([trust, np.zeros(OWN)])
        count = len(self._trust)
        self._weights = np.repeat(self._trust[:, np.newaxis], HORIZONS, axis=1)
        # For each horizon, the members' products with each other and with the true values.
        self._products = np.zeros((HORIZONS, count, count + 1))
        self._levels = np.ones(HORIZONS)
        # The members at the last steps of learning, and the history's count at them.
        self._made = np.zeros((HORIZONS, count, HORIZONS))
        self._counts = [NEVER] * HORIZONS
        self._steps = 0
        # The newest members, and the last paths.
        self._members = np.zeros((count, HORIZONS))
        self._earlier = np.zeros((KEPT, channels, HORIZONS))
        self._paths = 0

    def predict(self, newest: Floats, ahead: Floats, trajectories: Floats, paths: Floats) -> None:
        """Combine trajectories into paths of shape (channels, 25); call it at each step.

        newest, ahead: as in `History`. trajectories: of the experts, shape (n, channels, 25). The
        weights are learnt from the first channel.
        """
        combine(
            self._weights,
            trajectories,
            newest,
            ahead,
            self._earlier,
            self._paths,
            self._members,
            paths,
        )
        self._paths += 1

    def learn(self, history: History, artefact: bool = False) -> None:
        """Learn from the oldest members, and store the newest ones in their place.

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
        made[:] = self._members
        self._counts[place] = NEVER if artefact else history.count
