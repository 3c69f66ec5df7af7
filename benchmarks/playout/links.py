"""Links as traces of delay, and the best playout delays that each of them permits.

A trace holds each frame's delay from its instant to its arrival. All frames share one TCP
connection, as ZeroMQ's do: none overtakes another, so a delayed frame delays all that follow it,
and they arrive together.

The optima, a constant and a moving delay, are computed from the whole trace. A frame is late when
its delay is above the delay it is played with.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FRAME_NS = 5_000_000
FRAME_MS = FRAME_NS / 1e6
SECONDS = 300.0
DELAY_MS = 20.0
JITTER_MS = 3.0

Nanoseconds = NDArray[np.int64]
Milliseconds = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int], Milliseconds]


class DelayTrace(NamedTuple):
    """Instant and delay of each frame in ns, shape (frames,); frame i arrives at their sum."""

    sent_ns: Nanoseconds
    delay_ns: Nanoseconds

    @property
    def arrived_ns(self) -> Nanoseconds:
        """Arrival of each frame in ns, never before that of an earlier frame."""
        return self.sent_ns + self.delay_ns


def gaussian(rng: np.random.Generator, count: int) -> Milliseconds:
    """Draw the quiet path of all traces: 20 ± 3 ms, independent from frame to frame, above 0."""
    return np.maximum(rng.normal(DELAY_MS, JITTER_MS, count), 0.0)


def spikes(rng: np.random.Generator, count: int) -> Milliseconds:
    """Delay a frame by 100 ms every 20 s; `in_order` then holds the 20 frames sent meanwhile."""
    delay_ms = gaussian(rng, count)
    delay_ms[_frames(10) :: _frames(20)] += 100.0
    return delay_ms


def route_change(rng: np.random.Generator, count: int) -> Milliseconds:
    """Make the path 60 ms longer from the middle on."""
    delay_ms = gaussian(rng, count)
    delay_ms[count // 2 :] += 60.0
    return delay_ms


def drift(rng: np.random.Generator, count: int, ppm: float) -> Milliseconds:
    """Let the sensing node's clock drift by this many µs per second.

    The added delay rises from 0 or falls to 0, so that its mean does not depend on the sign.
    """
    drift_ms = np.arange(count) * (FRAME_NS * 1e-6) * ppm * 1e-6
    return gaussian(rng, count) + drift_ms - min(float(drift_ms[-1]), 0.0)


def bursts(rng: np.random.Generator, count: int, good_s: float, bad_s: float) -> Milliseconds:
    """Add Markov (Gilbert) bursts of 30 ms additional delay.

    Bursts last `bad_s` and pauses `good_s` on average, both geometrically distributed.
    """
    # Alternating durations, a pause first; more than are needed.
    pairs = 2 + int(2 * count / (_frames(good_s) + _frames(bad_s)) + 40)
    durations = np.empty(2 * pairs, dtype=np.int64)
    durations[0::2] = rng.geometric(1 / _frames(good_s), pairs)
    durations[1::2] = rng.geometric(1 / _frames(bad_s), pairs)
    bad = np.repeat(np.arange(2 * pairs) % 2, durations)[:count]
    return gaussian(rng, count) + 30.0 * bad


def random_spikes(rng: np.random.Generator, count: int, rate_hz: float) -> Milliseconds:
    """Delay frames at random, `rate_hz` times a second.

    The delay is at least 10 ms, Pareto-distributed with a tail index of 1.5 (mean 30 ms) and
    limited to 500 ms. Frames sent meanwhile wait with them.
    """
    delay_ms = gaussian(rng, count)
    held = rng.random(count) < rate_hz * FRAME_NS * 1e-9
    heights_ms = 10.0 * (1 + rng.pareto(1.5, count))
    return delay_ms + np.where(held, np.minimum(heights_ms, 500.0), 0.0)


def tcp_stalls(rng: np.random.Generator, count: int) -> Milliseconds:
    """Stall as TCP does at 0.5 % segment loss on a round trip of 40 ms, one segment for each frame.

    A lost frame is sent again after three duplicate acknowledgements: one round trip and three
    frames, 55 ms. If that is lost too, it is sent again after the smallest timeout of 200 ms
    (Linux; 1 s in RFC 6298). Frames sent meanwhile wait for it: head-of-line blocking.
    """
    loss, round_trip_ms, timeout_ms = 0.005, 2 * DELAY_MS, 200.0
    fast_ms = round_trip_ms + 3 * FRAME_NS * 1e-6
    lost, again = rng.random((2, count)) < loss
    return gaussian(rng, count) + np.where(lost, np.where(again, timeout_ms, fast_ms), 0.0)


GAUSSIAN, SPIKES, ROUTE = "Gaussian", "100 ms spikes", "+60 ms route"
FAST, SLOW = "+200 ppm", "−200 ppm"
BURSTS, RANDOM, TCP = "Markov bursts", "random spikes", "TCP stalls"
# The project's targets name these links without figures. We chose the figures; those of the random
# links decide which delay is attainable.
LINKS: dict[str, Draw] = {
    GAUSSIAN: gaussian,
    SPIKES: spikes,
    ROUTE: route_change,
    FAST: partial(drift, ppm=200.0),
    SLOW: partial(drift, ppm=-200.0),
    BURSTS: partial(bursts, good_s=10.0, bad_s=2.0),
    RANDOM: partial(random_spikes, rate_hz=0.5),
    TCP: tcp_stalls,
}


def make_trace(name: str, seconds: float = SECONDS) -> DelayTrace:
    """Make the trace of a link in `LINKS`, a frame every 5 ms; the same for the same seconds."""
    count = _frames(seconds)
    rng = np.random.default_rng([2026, list(LINKS).index(name)])
    return in_order(LINKS[name](rng, count))


def in_order(delay_ms: Milliseconds) -> DelayTrace:
    """Make a trace from each frame's own delay, shape (frames,); frames wait for earlier ones."""
    sent_ns = np.arange(len(delay_ms), dtype=np.int64) * FRAME_NS
    arrived_ns = np.maximum.accumulate(sent_ns + np.round(delay_ms * 1e6).astype(np.int64))
    return DelayTrace(sent_ns, arrived_ns - sent_ns)


def _frames(seconds: float) -> int:
    return round(seconds * 1e9 / FRAME_NS)


SLEW = 0.05
# Levels are 0.5 ms apart: at 5 % and a frame every 5 ms, the delay moves one level in two frames.
FRAMES_A_STEP = 2
# Bounds of the price of lateness (ms for a late share of 1, see `best_moving`), and the ratio of
# both at which the bisection stops.
LEAST_PRICE_MS, MOST_PRICE_MS = 10.0, 1e5
RESOLUTION = 1.05


class MovingDelay(NamedTuple):
    """A delay for every frame, shape (frames,), its mean in ms and the late share."""

    path_ms: Milliseconds
    mean_ms: float
    late: float


class Optimum(NamedTuple):
    """Lower bound on the mean delay of any path within the late share, and the best path found.

    The two may differ, since the bound comes from a Lagrangian dual (duality gap).
    """

    bound_ms: float
    best: MovingDelay


def best_constant_ms(delay_ms: Milliseconds, late: float) -> float:
    """Return the smallest constant delay that leaves at most this share of the frames late."""
    allowed = int(late * len(delay_ms))
    return float(np.sort(delay_ms)[::-1][allowed])


def best_moving(delay_ms: Milliseconds, late: float) -> Optimum:
    """Find the smallest mean delay with at most this late share and a slew of at most 5 %.

    The cost of a path is its mean delay plus a price times its late share (Lagrangian). Bisection
    finds the price at which the cheapest path has the permitted late share. Each price p gives the
    bound min(mean + p · share) − p · late.
    """
    low, high = LEAST_PRICE_MS, MOST_PRICE_MS
    best = cheapest(delay_ms, high)
    bound_ms = best.mean_ms + high * (best.late - late)
    while high > low * RESOLUTION:
        price_ms = float(np.sqrt(low * high))
        path = cheapest(delay_ms, price_ms)
        bound_ms = max(bound_ms, path.mean_ms + price_ms * (path.late - late))
        if path.late <= late:
            high = price_ms
            best = min(best, path, key=lambda one: one.mean_ms)
        else:
            low = price_ms
    return Optimum(bound_ms, best)


def cheapest(delay_ms: Milliseconds, price_ms: float) -> MovingDelay:
    """Find the moving delay of least mean + price · late share, by dynamic programming.

    A step is two frames. Levels are as far apart as the slew allows in one step, so the next step
    is at the same or a neighbouring level. Frames after the last whole step are left out.
    """
    level_ms = SLEW * FRAMES_A_STEP * FRAME_MS
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
    """Return the cost from each first level, and the best move from every step and level."""
    count = len(level_costs)
    moves = np.zeros((len(on_time), count), dtype=np.int8)
    # Cost of the following steps for each level; the infinite ends stand for levels out of range.
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
