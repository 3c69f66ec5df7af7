"""Continuation of the moments most similar to the present, and a regression among them.

The analogues are the lowest local minima of the present's distance from each lag (`distances.py`).

References
----------
Lorenz (1969), analogues as predictors; Sugihara (1994), locally weighted linear maps.
"""

import math
from typing import Final

import numpy as np

from display_node.prediction.distances import (
    ANALOGUES,
    FIRST_SLOPE,
    FORGETS,
    LAGS,
    MEMORIES_S,
    NEAREST,
    SLOPE,
    Places,
    Row,
    add_distances,
    find_analogues,
)
from display_node.prediction.expert import FURTHEST, HORIZONS, SPACING, Expert, Floats
from display_node.prediction.history import History, mean_about
from display_node.prediction.kernels import CUBE, FLOATS, PLACES, ROW, ROWS, TABLE, bounded, kernel
from display_node.prediction.ridge import solve_ridge

NAMES = (*[f"analogue {memory_s:g} s" for memory_s in MEMORIES_S], "analogue regression")
# Of the shortest memory's analogues, a mean uses the nearest AVERAGED, the regression all.
LOCALS: Final = 40
AVERAGED: Final = 15
# Of each trajectory: its first analogue and their number, and the width of the kernel over the
# mean distance of its nearest ones.
TRAJECTORIES = ((0, AVERAGED, 0.2), (40, 15, 0.2), (55, 15, 0.2), (0, LOCALS, 1.0))
BEGINS = tuple(begin for begin, _, _ in TRAJECTORIES)
LENGTHS = tuple(length for _, length, _ in TRAJECTORIES)
WIDTHS = tuple(width for _, _, width in TRAJECTORIES)
MEANS: Final = 3
# Share of the analogue's difference from the present value that its continuation is reduced by.
OFFSET: Final = 0.35
# A lag is used after its distance has been summed over this number of steps. The longer memories
# then still contain zeros from before the start, which make old lags less similar, not more.
SETTLED: Final = 20
# Inputs of the regression: means about lags, and the steps to each side of their middle. The longer
# ago, the wider they are: a few single values would have more noise than the analogues differ by.
LOCAL = np.array([2, 1, 3, 4, 6, 8, 11, 14, 18, 24, 32, 40, 50, 60, 80, 100, 130, 160, 200])
WIDTHS_ABOUT = np.array([0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 3, 3, 4, 5, 6, 8, 8, 10, 0])
SHARES_ABOUT = 1 / (2 * WIDTHS_ABOUT + 1)
INPUTS: Final = 19
DEEPEST: Final = 201
# It learns from the moments a step before each analogue and a step after it: their noise differs.
BESIDE = (-1, 1)
POINTS: Final = 80
# The weights of the analogues add up to 1.
LOCAL_RIDGE: Final = 0.00002


@kernel(f"void({ROWS}, int64, {PLACES}, {ROW}, {TABLE})")
def weigh_analogues(rows: Row, end: int, places: Places, nearest: Row, weights: Floats) -> None:
    """Write each trajectory's weights of its analogues, shape (4, 40), by the newest value.

    The weights fall with the distance, and add up to 1. nearest: what the memory keeps of the
    distances of the analogues.
    """
    first = end - 1 - LAGS
    row = rows[0]
    newest, before = row[end - 1], row[end - 1 - SPACING]
    distances = np.empty(ANALOGUES)
    for number in range(ANALOGUES):
        at = first + places[number]
        apart = row[at] - newest
        slope = row[at - SPACING] - before - apart
        weight = FIRST_SLOPE if number < LOCALS else SLOPE
        distances[number] = nearest[number] + apart * apart + weight * slope * slope
    for number in range(len(BEGINS)):
        begin, length = BEGINS[number], LENGTHS[number]
        memory_end = begin + (LOCALS if begin == 0 else length)
        least = distances[begin:memory_end].min()
        # The small constant keeps the width above 0 where all distances are 0.
        width = WIDTHS[number] * distances[begin : begin + AVERAGED].sum() / AVERAGED + 1e-30
        total = 0.0
        for analogue in range(length):
            kept = math.exp((least - distances[begin + analogue]) / width)
            weights[number, analogue] = kept
            total += kept
        for analogue in range(length):
            weights[number, analogue] /= total


@kernel(f"void({ROWS}, {FLOATS}, int64, {PLACES}, {TABLE}, {CUBE}, {FLOATS}, {TABLE}, {TABLE})")
def continue_analogues(
    rows: Row,
    sums: Floats,
    end: int,
    places: Places,
    weights: Floats,
    made: Floats,
    inputs: Floats,
    low: Floats,
    high: Floats,
) -> None:
    """Write the mean continuations of all channels, shape (4, channels, 25).

    Those of the last trajectory are without its regression. sums: as in `History`. inputs:
    where to write the present's inputs of the regression less those of its analogues' mean. low,
    high: where to write the range of the regression's continuations, shape (channels, 25).
    """
    first = end - 1 - LAGS
    steps = np.empty(FURTHEST + 1)
    for channel in range(len(rows)):
        row = rows[channel]
        newest = float(row[end - 1])
        low[channel, :], high[channel, :] = math.inf, -math.inf
        for number in range(len(BEGINS)):
            # Loops over values in a row are made of vector instructions, so all steps are added.
            steps[:] = 0.0
            for analogue in range(LENGTHS[number]):
                weight = weights[number, analogue]
                at = first + places[BEGINS[number] + analogue]
                followed = row[at : at + FURTHEST + 1]
                for step in range(FURTHEST + 1):
                    steps[step] += weight * followed[step]
                if number < MEANS:
                    continue
                for horizon in range(HORIZONS):
                    change = followed[SPACING * (horizon + 1)] - followed[0]
                    low[channel, horizon] = min(low[channel, horizon], change)
                    high[channel, horizon] = max(high[channel, horizon], change)
            origin = steps[0]
            shift = (1 - OFFSET) * (origin - newest) if number < MEANS else 0.0
            path = made[number, channel]
            for horizon in range(HORIZONS):
                path[horizon] = steps[SPACING * (horizon + 1)] - origin + shift
            if channel == 0 and number == MEANS:
                for tap in range(INPUTS):
                    lag, width = LOCAL[tap], WIDTHS_ABOUT[tap]
                    total = 0.0
                    for analogue in range(LOCALS):
                        at = first + places[analogue] - lag
                        about = sums[at + width + 1] - sums[at - width]
                        total += weights[MEANS, analogue] * about
                    mean = total / (2 * width + 1)
                    present = mean_about(sums, end - 1 - lag, width)
                    inputs[tap] = present - newest - (mean - origin)


@kernel(f"void({CUBE}, {FLOATS}, {CUBE}, {TABLE}, {TABLE})")
def add_regression(made: Floats, inputs: Floats, gains: Floats, low: Floats, high: Floats) -> None:
    """Add the regression to the last trajectory of each channel.

    A present unlike all its analogues is not extrapolated beyond them: low, high.
    """
    for channel in range(made.shape[1]):
        path = made[MEANS, channel]
        for tap in range(INPUTS):
            for horizon in range(HORIZONS):
                path[horizon] += inputs[tap] * gains[channel, tap, horizon]
        for horizon in range(HORIZONS):
            path[horizon] = bounded(path[horizon], low[channel, horizon], high[channel, horizon])


@kernel(f"void({ROWS}, {FLOATS}, int64, {PLACES}, {ROW}, {TABLE}, {CUBE}, boolean, {CUBE})")
def follow_analogues(
    rows: Row,
    sums: Floats,
    end: int,
    places: Places,
    nearest: Row,
    weights: Floats,
    gains: Floats,
    regresses: bool,
    made: Floats,
) -> None:
    """Write weights of the analogues, their mean continuations, and their regression if it is made.

    One kernel for the three: each call from Python costs as much as some hundred of its additions.
    """
    inputs = np.empty(INPUTS)
    low, high = np.empty((len(rows), HORIZONS)), np.empty((len(rows), HORIZONS))
    weigh_analogues(rows, end, places, nearest, weights)
    continue_analogues(rows, sums, end, places, weights, made, inputs, low, high)
    if regresses:
        add_regression(made, inputs, gains, low, high)
    else:
        made[MEANS] = made[0]


@kernel(f"void({TABLE}, {TABLE}, {TABLE})")
def add_points(points: Floats, shares: Floats, totals: Floats) -> None:
    """Write the products of each input with all columns of the points, weighted by their shares.

    points: shape (80, columns), of which the inputs are the first. shares: their weights times
    their inputs, shape (19, 80). totals: shape (19, columns). Eight points are added at a time: a
    total is else loaded and stored for each of them, which takes twice as long.
    """
    for tap in range(INPUTS):
        total, share = totals[tap], shares[tap]
        total[:] = 0.0
        for n in range(0, POINTS, 8):
            a, b, c, d = points[n], points[n + 1], points[n + 2], points[n + 3]
            e, f, g, h = points[n + 4], points[n + 5], points[n + 6], points[n + 7]
            of_a, of_b, of_c, of_d = share[n], share[n + 1], share[n + 2], share[n + 3]
            of_e, of_f, of_g, of_h = share[n + 4], share[n + 5], share[n + 6], share[n + 7]
            for column in range(len(total)):
                first = (of_a * a[column] + of_b * b[column]) + (
                    of_c * c[column] + of_d * d[column]
                )
                last = (of_e * e[column] + of_f * f[column]) + (of_g * g[column] + of_h * h[column])
                total[column] += first + last


@kernel(f"boolean({ROWS}, {FLOATS}, int64, {PLACES}, {FLOATS}, {CUBE})")
def regress(
    rows: Row, sums: Floats, end: int, places: Places, weights: Floats, gains: Floats
) -> bool:
    """Regress what followed the analogues on what preceded them; return whether it succeeded.

    weights: of the analogues. gains: where to write the regression's, shape (channels, 19, 25).
    """
    # One step later, each place is one step nearer to the present.
    first = end - LAGS
    channels = len(rows)
    # Of each point: the inputs less their mean, and then what followed.
    columns = INPUTS + channels * HORIZONS
    points, shares = np.empty((POINTS, columns)), np.empty((INPUTS, POINTS))
    for side in range(len(BESIDE)):
        mean = np.zeros(INPUTS)
        begin = side * LOCALS
        for number in range(LOCALS):
            at, point = first + places[number] + BESIDE[side], points[begin + number]
            for tap in range(INPUTS):
                middle, width = at - LOCAL[tap], WIDTHS_ABOUT[tap]
                about = sums[middle + width + 1] - sums[middle - width]
                point[tap] = about * SHARES_ABOUT[tap] - rows[0, at]
                mean[tap] += weights[number] * point[tap]
            for channel in range(channels):
                row, output = rows[channel], INPUTS + channel * HORIZONS
                for horizon in range(HORIZONS):
                    point[output + horizon] = row[at + SPACING * (horizon + 1)] - row[at]
        for number in range(LOCALS):
            weight, point = weights[number] / len(BESIDE), points[begin + number]
            for tap in range(INPUTS):
                point[tap] -= mean[tap]
                shares[tap, begin + number] = weight * point[tap]
    totals = np.empty((INPUTS, columns))
    add_points(points, shares, totals)
    squares, products = totals[:, :INPUTS].copy(), totals[:, INPUTS:].copy()
    for tap in range(INPUTS):
        squares[tap, tap] += LOCAL_RIDGE
    if not solve_ridge(squares, products):
        return False
    for channel in range(channels):
        gains[channel] = products[:, channel * HORIZONS : (channel + 1) * HORIZONS]
    return True


class Analogue(Expert):
    """Continuation of the moments of the last 40 s that are most similar to the present.

    The first trajectories are the analogues' mean continuations, one for each memory. The last is a
    ridge regression of the continuations on past values, among the analogues of the shortest
    memory: a linear filter for this moment of the beat.

    The lags of the minima and the regression's gains change slowly. They are computed for the next
    steps, which update the analogues' distances and means: so no prediction waits for them.
    """

    trust: tuple[float, ...] = (0.2, 0.1, 0.1, 0.4)

    def __init__(self, channels: int = 1) -> None:
        self.names: tuple[str, ...] = NAMES
        # Oldest first, like the history: index i is the lag LAGS − i. Single precision saves time
        # in these long rows; their noise exceeds its rounding.
        self._difference = np.zeros(LAGS, np.float32)
        self._distances = np.zeros((len(MEMORIES_S), LAGS), np.float32)
        self._found = self._regresses = False
        self._places = np.zeros(ANALOGUES, np.int64)
        self._nearest = np.zeros(ANALOGUES, np.float32)
        self._weights = np.zeros((len(TRAJECTORIES), LOCALS))
        self._gains = np.zeros((channels, INPUTS, HORIZONS))

    def predict(self, history: History, made: Floats) -> None:
        """Write the analogues' mean continuations, and their regression."""
        if not self._found:
            made[:] = 0.0
            return
        rows, end = history.buffer, history.end
        places, nearest, weights = self._places, self._nearest, self._weights
        follow_analogues(
            rows, history.sums, end, places, nearest, weights, self._gains, self._regresses, made
        )

    def prepare(self, history: History) -> None:
        """Find the analogues of the next two steps, or make the regression for them, in turn."""
        if history.count % SPACING == 0:
            # Rounding exceeds the ridge where the pulse has become many times as large.
            self._regresses = self._found and regress(
                history.buffer,
                history.sums,
                history.end,
                self._places,
                self._weights[MEANS],
                self._gains,
            )
            return
        add_distances(history.buffer, history.end, self._difference, self._distances, FORGETS)
        first = LAGS - min(LAGS - DEEPEST, history.count - SETTLED)
        self._found = first < LAGS - NEAREST - 2 and find_analogues(
            self._distances, first, FORGETS, self._places, self._nearest
        )
