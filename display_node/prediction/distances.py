"""Distance of the present from each moment of the last 40 s, and its lowest minima.

The distance from the moment at a lag l, with a memory λ, is updated by

    D(l) ← λ D(l) + (x(t) − x(t−l))² + w (ẋ(t) − ẋ(t−l))².

It is a loop over all lags at every second step, so it is made of vector instructions.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import SPACING
from display_node.prediction.grid import STEP_NS
from display_node.prediction.kernels import PLACES, ROW, ROWS, kernel

Row = NDArray[np.float32]
Places = NDArray[np.int64]

LAGS: Final = 8_000
# Smallest lag. At smaller ones, the next 250 ms are not known yet, or the beat is the present one.
NEAREST: Final = 60
MEMORIES_S = (0.05, 0.2, 0.6)
FORGETS = np.exp(-SPACING * STEP_NS * 1e-9 / np.array(MEMORIES_S)).astype(np.float32)
# Weight of the slope (per SPACING steps): the ratio of a pulse's power to that of its slope, so
# that both count about equally. In the shortest memory it is more, which finds the beginning of a
# beat sooner; in the others, more is noise.
SLOPE: Final = 12.5
FIRST_SLOPE: Final = 150.0
# Analogues of each memory, and the first one of each.
COUNTS = (40, 15, 15)
FIRSTS = (0, 40, 55)
ANALOGUES: Final = 70
# Lags that are skipped together where none of their distances is short enough; blocks of all lags.
BLOCK: Final = 64
BLOCKS: Final = LAGS // BLOCK
# Where an analogue has been lost, another one is looked for up to this, times the greatest distance
# of those that are left.
WIDER: Final = 1.5


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


@kernel(f"float32({ROW}, int64, {PLACES})")
def limit_minima(row: Row, first: int, places: Places) -> np.float32:
    """Return a distance that as many local minima after a lag as there are places do not exceed.

    places: of the lowest minima before, which are moved to those that they have become. Where two
    of them have become one, or one has left the lags, the distance is an estimate.
    """
    limit, kept = np.float32(-np.inf), 0
    for number in range(len(places)):
        place = places[number]
        while first < place < LAGS - NEAREST:
            if row[place - 1] <= row[place]:
                place -= 1
            elif row[place + 1] < row[place]:
                place += 1
            else:
                break
        if not (first < place < LAGS - NEAREST and row[place] < math.inf):
            continue
        found = False
        for other in range(kept):
            found |= places[other] == place
        if not found:
            places[kept] = place
            kept += 1
            limit = max(limit, row[place])
    if kept == 0:
        return np.float32(np.inf)
    return limit if kept == len(places) else np.float32(WIDER) * limit


@kernel(f"int64({ROW}, int64, float32, {PLACES}, {ROW})")
def find_lowest(row: Row, first: int, limit: np.float32, places: Places, nearest: Row) -> int:
    """Write the lowest local minima after a lag up to a limit, the nearest first.

    places, nearest: where to write their places and distances. Returns their number.
    """
    most, found = len(places), 0
    blocks = row.reshape((BLOCKS, BLOCK))
    for block in range((first + 1) // BLOCK, BLOCKS):
        # A count over a constant range is a loop of vector instructions.
        within = 0
        for lag in range(BLOCK):
            within += blocks[block, lag] <= limit
        if not within:
            continue
        end = min((block + 1) * BLOCK, LAGS - NEAREST)
        for place in range(max(block * BLOCK, first + 1), end):
            distance = row[place]
            if distance > limit or distance >= row[place - 1] or distance > row[place + 1]:
                continue
            # Of equal distances, the first ones are kept.
            if found == most and distance >= nearest[most - 1]:
                continue
            found = min(found + 1, most)
            at = found - 1
            while at > 0 and nearest[at - 1] > distance:
                nearest[at], places[at] = nearest[at - 1], places[at - 1]
                at -= 1
            nearest[at], places[at] = distance, place
            if found == most:
                limit = nearest[most - 1]
    return found


@kernel(f"boolean({ROWS}, int64, {ROW}, {PLACES}, {ROW})")
def find_analogues(distances: Row, first: int, forgets: Row, places: Places, nearest: Row) -> bool:
    """Write each memory's lowest local minima after a lag, the nearest first.

    A memory with fewer minima repeats them. places: those found before, or zeros. nearest: where to
    write what the memories keep of their distances. Returns False if a memory has none.
    """
    for memory in range(len(COUNTS)):
        begin, most = FIRSTS[memory], COUNTS[memory]
        row = distances[memory]
        lowest, least = places[begin : begin + most], nearest[begin : begin + most]
        limit = limit_minima(row, first, lowest)
        found = find_lowest(row, first, limit, lowest, least)
        if found < most and limit < math.inf:
            found = find_lowest(row, first, np.float32(np.inf), lowest, least)
        if not found:
            return False
        for more in range(found, most):
            lowest[more], least[more] = lowest[more - found], least[more - found]
        for number in range(most):
            least[number] *= forgets[memory]
    return True
