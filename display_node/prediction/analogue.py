"""Continuation of the moments most similar to the present, and a regression among them.

The present's distance from each lag l, with a memory λ, is updated by

    D(l) ← λ D(l) + (x(t) − x(t−l))² + w (ẋ(t) − ẋ(t−l))²,

and its lowest local minima are the analogues.

References
----------
Lorenz (1969), analogues as predictors; Sugihara (1994), locally weighted linear maps.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import HORIZONS, SPACING, Expert, Floats
from display_node.prediction.grid import STEP_NS
from display_node.prediction.history import History
from display_node.prediction.kernels import CUBE, FLOATS, PLACES, ROW, ROWS, TABLE, bounded, kernel
from display_node.prediction.ridge import solve_ridge

Row = NDArray[np.float32]
Places = NDArray[np.int64]

LAGS: Final = 8_000
# Smallest lag. At smaller ones, the next 250 ms are not known yet, or the beat is the present one.
NEAREST: Final = 60
MEMORIES_S = (0.05, 0.2, 0.6)
NAMES = (*[f"analogue {memory_s:g} s" for memory_s in MEMORIES_S], "analogue regression")
FORGETS = np.exp(-SPACING * STEP_NS * 1e-9 / np.array(MEMORIES_S)).astype(np.float32)
# Weight of the slope (per SPACING steps): the ratio of a pulse's power to that of its slope, so
# that both count about equally. In the shortest memory it is more, which finds the beginning of a
# beat sooner; in the others, more is noise.
SLOPE: Final = 12.5
FIRST_SLOPE: Final = 150.0
# Analogues of each memory, and the first one of each. Of the first memory's, a mean uses the
# nearest AVERAGED, the regression all.
COUNTS = (40, 15, 15)
FIRSTS = (0, 40, 55)
ANALOGUES: Final = 70
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
# Lags of the regression's inputs.
LOCAL = np.array([2, 1, 3, 4, 6, 8, 11, 14, 18, 24, 32, 40, 50, 60, 80, 100, 130, 160, 200])
INPUTS: Final = 19
DEEPEST: Final = 200
# Lags that are skipped together where none of their distances is short enough.
BLOCK: Final = 64
# The weights of the analogues add up to 1.
LOCAL_RIDGE: Final = 0.00003


@kernel(f"void({ROWS}, int64, {ROW}, {ROWS}, {ROW})")
def add_distances(rows: Row, end: int, difference: Row, distances: Row, forgets: Row) -> None:
    """Update the distances of all lags, oldest first, for the newest value of the first channel.

    difference: of the newest value from each lag's; it is replaced.
    """
    # Rows as views: their places count from 0, and the loop becomes one of vector instructions.
    past, newest = rows[0, end - 1 - LAGS : end - 1], rows[0, end - 1]
    short, middle, long = distances[0], distances[1], distances[2]
    keep_short, keep_middle, keep_long = forgets[0], forgets[1], forgets[2]
    slope_weight, first_weight = np.float32(SLOPE), np.float32(FIRST_SLOPE)
    for lag in range(LAGS):
        apart = past[lag] - newest
        # The slopes' difference is the change of the values' difference since the last time.
        slope = difference[lag] - apart
        difference[lag] = apart
        square, slope_square = apart * apart, slope * slope
        short[lag] = short[lag] * keep_short + (square + first_weight * slope_square)
        square += slope_weight * slope_square
        middle[lag] = middle[lag] * keep_middle + square
        long[lag] = long[lag] * keep_long + square


@kernel(f"boolean({ROWS}, int64, {ROW}, {PLACES}, {ROW})")
def find_analogues(distances: Row, first: int, forgets: Row, places: Places, nearest: Row) -> bool:
    """Write each memory's lowest local minima from a lag on, the nearest first.

    A memory with fewer minima repeats them. nearest: where to write what the memories keep of their
    distances. Returns False if a memory has none.
    """
    for memory in range(len(COUNTS)):
        begin, most = FIRSTS[memory], COUNTS[memory]
        row = distances[memory]
        found, limit = 0, np.float32(np.inf)
        for block in range(first + 1, LAGS - NEAREST, BLOCK):
            end = min(block + BLOCK, LAGS - NEAREST)
            # A count is a loop of vector instructions; distances from the limit on are too long.
            below = 0
            for distance in row[block:end]:
                below += distance < limit
            if not below:
                continue
            for place in range(block, end):
                distance = row[place]
                if distance >= limit or distance >= row[place - 1] or distance > row[place + 1]:
                    continue
                found = min(found + 1, most)
                at = begin + found - 1
                while at > begin and nearest[at - 1] > distance:
                    nearest[at], places[at] = nearest[at - 1], places[at - 1]
                    at -= 1
                nearest[at], places[at] = distance, place
                if found == most:
                    limit = nearest[begin + most - 1]
        if not found:
            return False
        for more in range(found, most):
            places[begin + more] = places[begin + more - found]
            nearest[begin + more] = nearest[begin + more - found]
        for number in range(begin, begin + most):
            nearest[number] *= forgets[memory]
    return True


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


@kernel(f"void({ROWS}, int64, {PLACES}, {TABLE}, {CUBE}, {FLOATS}, {TABLE}, {TABLE})")
def continue_analogues(
    rows: Row,
    end: int,
    places: Places,
    weights: Floats,
    made: Floats,
    inputs: Floats,
    low: Floats,
    high: Floats,
) -> None:
    """Write the mean continuations of all channels, shape (4, channels, 25).

    Those of the last trajectory are without its regression. inputs: where to write the present's
    values at the regression's lags less those of its analogues' mean. low, high: where to write the
    range of the regression's continuations, shape (channels, 25).
    """
    first = end - 1 - LAGS
    for channel in range(len(rows)):
        row = rows[channel]
        newest = float(row[end - 1])
        low[channel, :], high[channel, :] = math.inf, -math.inf
        for number in range(len(BEGINS)):
            path = made[number, channel]
            path[:] = 0.0
            origin = 0.0
            for analogue in range(LENGTHS[number]):
                weight = weights[number, analogue]
                at = first + places[BEGINS[number] + analogue]
                origin += weight * row[at]
                for horizon in range(HORIZONS):
                    path[horizon] += weight * row[at + SPACING * (horizon + 1)]
                if number < MEANS:
                    continue
                for horizon in range(HORIZONS):
                    followed = row[at + SPACING * (horizon + 1)] - row[at]
                    low[channel, horizon] = min(low[channel, horizon], followed)
                    high[channel, horizon] = max(high[channel, horizon], followed)
            shift = (1 - OFFSET) * (origin - newest) if number < MEANS else 0.0
            for horizon in range(HORIZONS):
                path[horizon] += shift - origin
            if channel == 0 and number == MEANS:
                for tap in range(INPUTS):
                    mean = 0.0
                    for analogue in range(LOCALS):
                        at = first + places[analogue] - LOCAL[tap]
                        mean += weights[MEANS, analogue] * row[at]
                    inputs[tap] = row[end - 1 - LOCAL[tap]] - newest - (mean - origin)


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


@kernel(f"boolean({ROWS}, int64, {PLACES}, {FLOATS}, {CUBE})")
def regress(rows: Row, end: int, places: Places, weights: Floats, gains: Floats) -> bool:
    """Regress what followed the analogues on what preceded them; return whether it succeeded.

    weights: of the analogues. gains: where to write the regression's, shape (channels, 19, 25).
    """
    # One step later, each place is one step nearer to the present.
    first = end - LAGS
    channels = len(rows)
    before = np.empty((LOCALS, INPUTS))
    mean = np.zeros(INPUTS)
    for number in range(LOCALS):
        at = first + places[number]
        for tap in range(INPUTS):
            before[number, tap] = rows[0, at - LOCAL[tap]] - rows[0, at]
            mean[tap] += weights[number] * before[number, tap]
    squares = np.zeros((INPUTS, INPUTS))
    products = np.zeros((INPUTS, channels * HORIZONS))
    after = np.empty(channels * HORIZONS)
    for number in range(LOCALS):
        at = first + places[number]
        for channel in range(channels):
            row, begin = rows[channel], channel * HORIZONS
            for horizon in range(HORIZONS):
                followed = row[at + SPACING * (horizon + 1)] - row[at]
                after[begin + horizon] = followed
        taps = before[number]
        for tap in range(INPUTS):
            taps[tap] -= mean[tap]
        for tap in range(INPUTS):
            weighted, square, product = weights[number] * taps[tap], squares[tap], products[tap]
            for other in range(tap + 1):
                square[other] += weighted * taps[other]
            for output in range(len(after)):
                product[output] += weighted * after[output]
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
        self._inputs = np.zeros(INPUTS)
        self._gains = np.zeros((channels, INPUTS, HORIZONS))
        self._low, self._high = np.zeros((2, channels, HORIZONS))

    def predict(self, history: History, made: Floats) -> None:
        """Write the analogues' mean continuations, and their regression."""
        if not self._found:
            made[:] = 0.0
            return
        rows, end = history.buffer, history.end
        weigh_analogues(rows, end, self._places, self._nearest, self._weights)
        continue_analogues(
            rows,
            end,
            self._places,
            self._weights,
            made,
            self._inputs,
            self._low,
            self._high,
        )
        if self._regresses:
            add_regression(made, self._inputs, self._gains, self._low, self._high)
        else:
            made[-1] = made[0]

    def prepare(self, history: History) -> None:
        """Find the analogues of the next two steps, or make the regression for them, in turn."""
        if history.count % SPACING == 0:
            # Rounding exceeds the ridge where the pulse has become many times as large.
            self._regresses = self._found and regress(
                history.buffer, history.end, self._places, self._weights[MEANS], self._gains
            )
            return
        add_distances(history.buffer, history.end, self._difference, self._distances, FORGETS)
        first = LAGS - min(LAGS - DEEPEST, history.count - SETTLED)
        self._found = first < LAGS - NEAREST - 2 and find_analogues(
            self._distances, first, FORGETS, self._places, self._nearest
        )
