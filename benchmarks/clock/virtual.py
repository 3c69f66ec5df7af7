"""The clock in virtual time: many seeds of many kinds of link.

Delays are those of the models in `telepulse/simulation/link_model`, with TCP's; delays of the
kernel itself are left out.
"""

import itertools
import random
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks.benchmark import Benchmark
from benchmarks.clock.scaled import scaled_ns
from display_node.reception.receiver import CLOCK_EVERY_NS, CLOCK_FAST_COUNT, CLOCK_FAST_NS
from protocol.clock.estimator import ClockEstimator, ClockExchange
from telepulse.simulation.link_model import Direction, TcpStream
from telepulse.simulation.link_scene import parse_link

# Not the seeds on which the clock's constants were chosen: 0 to 39 and 1000 to 3059.
SEEDS = range(5_000, 5_040)
SECONDS = 60
MARKS_S = (5, 60)
SKEWS_PPM = (-200.0, 0.0, 200.0)
S = 1_000_000_000
REQUEST_BYTES = 80
FRAME_EVERY_NS, FRAME_BYTES = 5_000_000, 160
ANSWERED_AFTER_NS = 50_000
BAR = "delay=20ms,jitter=3ms,loss=1%"


@dataclass(frozen=True, slots=True)
class Exponential:
    """A path without loss whose delay beyond 20 ms is exponential: a queue shared with others."""

    mean_ns: float
    random: random.Random

    def arrival_ns(self, now_ns: int, _: int) -> int | None:
        """Return the arrival of a message that is sent now."""
        return now_ns + 20_000_000 + round(self.random.expovariate(1 / self.mean_ns))


class Way(Protocol):
    """One direction of a link."""

    def arrival_ns(self, now_ns: int, size_bytes: int, /) -> int | None:
        """Return the arrival of a message that is sent now; None when it is lost."""


# Both directions. "tcp": messages on a TCP connection; a number: mean of exponential delays in ms.
LINKS: dict[str, tuple[str, str]] = {
    "20±3 ms, 1 % loss, TCP": (f"tcp {BAR}", f"tcp {BAR}"),
    "the same, datagrams": (BAR, BAR),
    "40±10 ms": ("delay=40ms,jitter=10ms",) * 2,
    "Pareto 5 ms, TCP": ("tcp delay=20ms,jitter=5ms,jitter_kind=pareto,loss=1%",) * 2,
    "standstills 20 ms": ("delay=20ms,jitter=20ms,jitter_kind=bursts",) * 2,
    "30±1 ms, 3 % loss, TCP": ("tcp delay=30ms,jitter=1ms,loss=3%",) * 2,
    "loss in bursts, TCP": (f"tcp {BAR},burst_loss.share=2%,burst_loss.length=300ms",) * 2,
    "exponential 5 ms": ("5", "5"),
    "exponential 10 ms, there only": ("10", "delay=20ms"),
    "1 ms longer back after 30 s, TCP": (
        f"tcp {BAR}",
        f"tcp {BAR},route_change.at=30s,route_change.by=1ms",
    ),
}


def main(benchmark: Benchmark) -> None:
    """Print a table with the stream's frames and one without."""
    marks = [f"{q} {mark_s} s" for mark_s in MARKS_S for q in ("95 %", "worst")]
    for with_frames in (True, False):
        rows = [row(name, with_frames) for name in LINKS]
        used = "exchanges and frames" if with_frames else "exchanges alone"
        benchmark.table(
            f"Clock in virtual time, {used}, {len(SEEDS)} seeds each, skew 0 and ±200 ppm: offset"
            " error in ms; share of exchanges when it was within the stated uncertainty; skew error"
            " in ppm at 60 s",
            ("link", *marks, "within", "ppm 95 %", "µs"),
            rows,
        )


def row(name: str, with_frames: bool) -> tuple[str, ...]:
    """Return one link's row."""
    trials = [trial(*LINKS[name], seed, SKEWS_PPM[seed % 3], with_frames) for seed in SEEDS]
    cells = []
    for number in range(len(MARKS_S)):
        errors_ms = [each.errors_ms[number] for each in trials]
        cells += [f"{np.quantile(errors_ms, 0.95):.3f}", f"{max(errors_ms):.3f}"]
    within = np.mean([each.within for each in trials])
    ppm = np.quantile([each.skew_error_ppm for each in trials], 0.95)
    cost_us = np.mean([each.cost_us for each in trials])
    return (name, *cells, f"{within:.1%}", f"{ppm:.1f}", f"{cost_us:.0f}")


@dataclass(frozen=True, slots=True)
class Trial:
    """Errors at `MARKS_S` and at the end; cost_us: mean cost of an exchange."""

    errors_ms: list[float]
    within: float
    skew_error_ppm: float
    cost_us: float


def trial(there: str, back: str, seed: int, skew_ppm: float, with_frames: bool) -> Trial:
    """Follow one clock over one link."""
    estimator, marks_s, errors_ms = ClockEstimator(), list(MARKS_S), []
    within = count = 0
    cost_s = 0.0
    # Frames have a connection of their own.
    coming = deque(frames(way(back, 1_000_000 + seed), skew_ppm) if with_frames else ())
    for exchange in exchanges(way(there, 2 * seed), way(back, 2 * seed + 1), skew_ppm):
        now_ns = exchange.t4_ns
        while coming and coming[0][0] < now_ns:
            arrived_ns, sent_ns = coming.popleft()
            estimator.add_one_way(sent_ns, arrived_ns)
        while marks_s and now_ns > marks_s[0] * S:
            errors_ms.append(error_ns(estimator, marks_s.pop(0) * S, skew_ppm) * 1e-6)
        began_s = time.perf_counter()
        estimator.add(exchange)
        cost_s += time.perf_counter() - began_s
        count += 1
        within += error_ns(estimator, now_ns, skew_ppm) <= estimator.uncertainty_ns(now_ns)
    errors_ms += [error_ns(estimator, mark_s * S, skew_ppm) * 1e-6 for mark_s in marks_s]
    skew_error_ppm = abs(estimator.skew_ppm - skew_ppm)
    return Trial(errors_ms, within / count, skew_error_ppm, cost_s / count * 1e6)


def error_ns(estimator: ClockEstimator, local_ns: int, skew_ppm: float) -> int:
    """Return the estimate's error."""
    return abs(estimator.remote_ns(local_ns) - scaled_ns(local_ns, 0, skew_ppm))


def way(text: str, seed: int) -> Way:
    """Return a direction as `LINKS` describes it."""
    if text.isdigit():
        return Exponential(float(text) * 1e6, random.Random(seed))
    transport, _, link = text.rpartition(" ")
    direction = Direction(parse_link(link), seed)
    return TcpStream(direction) if transport == "tcp" else direction


def exchanges(there: Way, back: Way, skew_ppm: float) -> list[ClockExchange]:
    """Yield all exchanges of `SECONDS` at a receiver's pace, in the order of their replies."""
    arrived = []
    for t1_ns in itertools.takewhile(lambda t_ns: t_ns < SECONDS * S, asked_ns()):
        there_ns = there.arrival_ns(t1_ns, REQUEST_BYTES)
        if there_ns is not None:
            arrived.append((there_ns, t1_ns))
    answered = []
    for there_ns, t1_ns in sorted(arrived):
        leaves_ns = there_ns + ANSWERED_AFTER_NS
        t4_ns = back.arrival_ns(leaves_ns, REQUEST_BYTES)
        if t4_ns is not None:
            t2_ns, t3_ns = (scaled_ns(t_ns, 0, skew_ppm) for t_ns in (there_ns, leaves_ns))
            answered.append(ClockExchange(t1_ns, t2_ns, t3_ns, t4_ns))
    return sorted(answered, key=lambda exchange: exchange.t4_ns)


def frames(back: Way, skew_ppm: float) -> list[tuple[int, int]]:
    """Yield each frame's arrival, and the remote clock when it was sent."""
    arrived = []
    for sent_ns in range(0, SECONDS * S, FRAME_EVERY_NS):
        arrival_ns = back.arrival_ns(sent_ns, FRAME_BYTES)
        if arrival_ns is not None:
            arrived.append((arrival_ns, scaled_ns(sent_ns, 0, skew_ppm)))
    return sorted(arrived)


def asked_ns() -> Iterator[int]:
    """Yield the times of requests."""
    t_ns = 0
    for number in itertools.count():
        yield t_ns
        t_ns += CLOCK_FAST_NS if number < CLOCK_FAST_COUNT else CLOCK_EVERY_NS
