"""What playing a trace costs at least: the best constant delay, and the best moving one.

Both know the whole trace beforehand. Times in ms; a frame is late when its delay is above the
delay it is played with.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SLEW = 0.05
# Levels of 0.5 ms: at 5 % and a frame every 5 ms, one up or down every two frames.
FRAMES_A_STEP = 2
# Between these prices of lateness the bisection looks, until it is this sure.
LEAST_MS, MOST_MS = 10.0, 1e5
SURE = 1.05

Milliseconds = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MovingDelay:
    """A delay for every frame, shape (frames,), and what it costs."""

    path_ms: Milliseconds
    delay_ms: float
    late: float


@dataclass(frozen=True, slots=True)
class Optimum:
    """No moving delay within the late share has a mean below `bound_ms`; `best` has been found.

    The two differ where the costs' hull is not reached by any one path (a duality gap).
    """

    bound_ms: float
    best: MovingDelay


def best_constant_ms(delay_ms: Milliseconds, late: float) -> float:
    """The smallest constant delay that leaves at most this share of the frames late."""
    allowed = int(late * len(delay_ms))
    return float(np.sort(delay_ms)[::-1][allowed])


def best_moving(delay_ms: Milliseconds, late: float, frame_ms: float) -> Optimum:
    """The smallest mean delay with at most this late share and a slew of at most 5 %.

    A Lagrangian makes lateness a price; its bisection finds the price at which the cheapest path
    is late just often enough. Any price p gives the bound min(mean + p · share) − p · late.
    """
    low, high = LEAST_MS, MOST_MS
    best = cheapest(delay_ms, high, frame_ms)
    bound_ms = best.delay_ms + high * (best.late - late)
    while high > low * SURE:
        price_ms = float(np.sqrt(low * high))
        path = cheapest(delay_ms, price_ms, frame_ms)
        bound_ms = max(bound_ms, path.delay_ms + price_ms * (path.late - late))
        if path.late <= late:
            high = price_ms
            best = min(best, path, key=lambda one: one.delay_ms)
        else:
            low = price_ms
    return Optimum(bound_ms, best)


def cheapest(delay_ms: Milliseconds, price_ms: float, frame_ms: float) -> MovingDelay:
    """The moving delay with the smallest mean + price · late share, by dynamic programming.

    Levels are as far apart as the slew reaches in a step of two frames; a step costs its level
    and its late frames, and the next step is at the same level or a neighbour. What is over
    after the last whole step is left out.
    """
    level_ms = SLEW * FRAMES_A_STEP * frame_ms
    lowest = int(np.floor(delay_ms.min() / level_ms))
    highest = int(np.ceil(delay_ms.max() / level_ms))
    levels_ms = level_ms * np.arange(lowest, highest + 1, dtype=np.float64)
    steps = len(delay_ms) // FRAMES_A_STEP
    grouped = delay_ms[: steps * FRAMES_A_STEP].reshape(steps, FRAMES_A_STEP)
    # The first level at which each frame is on time.
    on_time = np.searchsorted(levels_ms, grouped)
    costs_ms, moves = _moves(on_time.tolist(), FRAMES_A_STEP * levels_ms, price_ms)
    position = int(costs_ms.argmin())
    path = np.empty(steps, dtype=np.int64)
    for step in range(steps):
        path[step] = position
        if step + 1 < steps:
            position += int(moves[step, position])
    path_ms = np.repeat(levels_ms[path], FRAMES_A_STEP)
    late = float((grouped.ravel() > path_ms).mean())
    return MovingDelay(path_ms, float(path_ms.mean()), late)


def _moves(
    on_time: list[list[int]], level_costs: Milliseconds, price_ms: float
) -> tuple[Milliseconds, NDArray[np.int8]]:
    """The cost from each first level on, and from every step and level the best move."""
    count = len(level_costs)
    moves = np.zeros((len(on_time), count), dtype=np.int8)
    # The cost of what follows, between two levels that do not exist.
    padded = np.full(count + 2, np.inf)
    here, below, above = padded[1:-1], padded[:-2], padded[2:]
    here[:] = 0.0
    for step in range(len(on_time) - 1, -1, -1):
        moves[step] = above < here
        moves[step] -= (below < here) & (below <= above)
        here[:] = np.minimum(np.minimum(below, above), here)
        here += level_costs
        for first in on_time[step]:
            here[:first] += price_ms
    return here, moves
