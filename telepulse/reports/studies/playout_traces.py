"""Links as traces of delay: what every frame of a stream needs from its instant to its arrival.

All frames share one TCP connection, as ZeroMQ's do: none overtakes another, so a frame that is
held up holds up all that follow it, and they arrive together.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FRAME_NS = 5_000_000
SECONDS = 300.0
DELAY_MS = 20.0
JITTER_MS = 3.0
CAP_MS = 500.0

Nanoseconds = NDArray[np.int64]
Milliseconds = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int], Milliseconds]


@dataclass(frozen=True, slots=True)
class DelayTrace:
    """One frame's instant and delay after the other, in ns; frame i arrives at their sum."""

    name: str
    sent_ns: Nanoseconds
    delay_ns: Nanoseconds

    @property
    def arrived_ns(self) -> Nanoseconds:
        """When each frame arrives; never before the one sent before it."""
        return self.sent_ns + self.delay_ns


def gaussian(rng: np.random.Generator, count: int) -> Milliseconds:
    """The quiet path of all traces: 20 ± 3 ms, independent from frame to frame, above 0."""
    return np.maximum(rng.normal(DELAY_MS, JITTER_MS, count), 0.0)


def spikes(rng: np.random.Generator, count: int) -> Milliseconds:
    """Every 20 s a frame is held up by 100 ms, and with it the 20 frames sent meanwhile."""
    delay_ms = gaussian(rng, count)
    delay_ms[_frames(10) :: _frames(20)] += 100.0
    return delay_ms


def route_change(rng: np.random.Generator, count: int) -> Milliseconds:
    """Half way through the path becomes 60 ms longer, for good."""
    delay_ms = gaussian(rng, count)
    delay_ms[count // 2 :] += 60.0
    return delay_ms


def drift(ppm: float) -> Draw:
    """The sensing node's clock, taken to be in step, runs apart by this many µs a second.

    Counted up from 0 or down to 0, so that the mean of the added delay is the same.
    """

    def draw(rng: np.random.Generator, count: int) -> Milliseconds:
        drift_ms = np.arange(count) * (FRAME_NS * 1e-6) * ppm * 1e-6
        return gaussian(rng, count) + drift_ms - min(float(drift_ms[-1]), 0.0)

    return draw


def bursts(good_s: float, bad_s: float, extra_ms: float) -> Draw:
    """Markov (Gilbert) bursts: a state that adds `extra_ms` comes and goes.

    It lasts `bad_s` on average and stays away for `good_s`, both geometrically distributed.
    """

    def draw(rng: np.random.Generator, count: int) -> Milliseconds:
        # Durations in turns, good first; more than enough of them.
        pairs = 2 + int(2 * count / (_frames(good_s) + _frames(bad_s)) + 40)
        durations = np.empty(2 * pairs, dtype=np.int64)
        durations[0::2] = rng.geometric(1 / _frames(good_s), pairs)
        durations[1::2] = rng.geometric(1 / _frames(bad_s), pairs)
        bad = np.repeat(np.arange(2 * pairs) % 2, durations)[:count]
        return gaussian(rng, count) + extra_ms * bad

    return draw


def random_spikes(rate_hz: float) -> Draw:
    """Frames held up at random, `rate_hz` times a second.

    By at least 10 ms, Pareto-distributed with a tail index of 1.5 (mean 30 ms) and cut at
    500 ms. The frames sent meanwhile wait with them.
    """

    def draw(rng: np.random.Generator, count: int) -> Milliseconds:
        delay_ms = gaussian(rng, count)
        held = rng.random(count) < rate_hz * FRAME_NS * 1e-9
        heights_ms = 10.0 * (1 + rng.pareto(1.5, count))
        return delay_ms + np.where(held, np.minimum(heights_ms, CAP_MS), 0.0)

    return draw


def tcp_stalls(rng: np.random.Generator, count: int) -> Milliseconds:
    """TCP at 0.5 % segment loss on a round trip of 40 ms, a segment a frame.

    A lost frame is sent again after three duplicate acknowledgements: one round trip and
    three frames, 55 ms. When that is lost too, after the usual smallest timeout of 200 ms
    (Linux; RFC 6298 says 1 s). Frames sent meanwhile wait for it: head-of-line blocking.
    """
    loss, round_trip_ms, timeout_ms = 0.005, 2 * DELAY_MS, 200.0
    fast_ms = round_trip_ms + 3 * FRAME_NS * 1e-6
    lost, again = rng.random((2, count)) < loss
    return gaussian(rng, count) + np.where(lost, np.where(again, timeout_ms, fast_ms), 0.0)


GAUSSIAN, SPIKES, ROUTE = "Gaussian", "100 ms spikes", "+60 ms route"
FAST, SLOW = "+200 ppm", "−200 ppm"
BURSTS, RANDOM, TCP = "Markov bursts", "random spikes", "TCP stalls"
SHORT_BURSTS, DENSE = "short bursts", "dense spikes"
# The bars name the links but not these figures: they are ours, and the random ones decide
# on what is possible. The last two are harder ones of the same kinds, and have no bar.
LINKS: dict[str, Draw] = {
    GAUSSIAN: gaussian,
    SPIKES: spikes,
    ROUTE: route_change,
    FAST: drift(200.0),
    SLOW: drift(-200.0),
    BURSTS: bursts(10.0, 2.0, 30.0),
    RANDOM: random_spikes(0.5),
    TCP: tcp_stalls,
    SHORT_BURSTS: bursts(2.0, 0.2, 30.0),
    DENSE: random_spikes(1.0),
}


def make_trace(name: str, seconds: float = SECONDS) -> DelayTrace:
    """The trace of a link in `LINKS`: a frame every 5 ms; the same for the same seconds."""
    count = _frames(seconds)
    rng = np.random.default_rng([2026, list(LINKS).index(name)])
    return in_order(name, LINKS[name](rng, count))


def in_order(name: str, delay_ms: Milliseconds) -> DelayTrace:
    """The trace of frames that need so long, shape (frames,), and wait for those before them."""
    sent_ns = np.arange(len(delay_ms), dtype=np.int64) * FRAME_NS
    arrived_ns = np.maximum.accumulate(sent_ns + np.round(delay_ms * 1e6).astype(np.int64))
    return DelayTrace(name, sent_ns, arrived_ns - sent_ns)


def _frames(seconds: float) -> int:
    return round(seconds * 1e9 / FRAME_NS)
