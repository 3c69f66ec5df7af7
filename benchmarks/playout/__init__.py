"""Mean delay and late frames of our playout delay over eight links, beside two offline optima.

Our delay is tuned for the least mean delay within the permitted late share. Both optima, a constant
and a moving delay, are computed from the whole trace.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.benchmark import Benchmark
from benchmarks.criteria import CRITERIA
from benchmarks.playout import links
from benchmarks.playout.links import DelayTrace, Nanoseconds
from display_node.reception.link_delay import LATE_TARGET, DelayEstimator
from display_node.reception.playout_clock import PlayoutClock

MS = 1e6
# Late targets, from that with fewest late frames to that with most.
FEWEST, MOST = 1e-4, 0.3
CONSTANT, MOVING = "best constant", "best moving, 5 %"


@dataclass(frozen=True, slots=True)
class Effort:
    """Amount of computing.

    scan: settings tried over a parameter's whole range; bisections: further ones after them.
    """

    seconds: float = links.SECONDS
    scan: int = 4
    bisections: int = 5


QUICK = Effort(seconds=5.0, scan=2, bisections=1)


class PlayedTrace(NamedTuple):
    """Mean delay in ms at which a trace's frames were played, and the share that came late."""

    delay_ms: float
    late: float

    def __str__(self) -> str:
        return f"{self.delay_ms:.1f} / {100 * self.late:.1f}"


class Tuned(NamedTuple):
    """The least delay within the permitted late share if it was `reached`, else fewest late."""

    played: PlayedTrace
    reached: bool


class LinkScore(NamedTuple):
    """Figures of a link.

    smallest_ms: its smallest delay. optima_ms: of MOVING a lower bound; found_ms is the mean delay
    of the best path that was found. tuned: our delay. default, warped: the default late target,
    free to change at once and with the display's slew limit.
    """

    smallest_ms: float
    optima_ms: dict[str, float]
    found_ms: float
    tuned: Tuned
    default: PlayedTrace
    warped: PlayedTrace


def main(benchmark: Benchmark) -> None:
    """Play every link, print the tables, and judge our delay by the optima."""
    effort, names = QUICK if benchmark.quick else Effort(), list(links.LINKS)
    scores = benchmark.run(partial(score_link, effort=effort), names)
    judged, rows = {criterion.name for criterion in CRITERIA["playout"]}, []
    for link, score in zip(names, scores, strict=True):
        ours_ms, least_ms = score.tuned.played.delay_ms, score.smallest_ms
        late = "" if score.tuned.reached else f" at {100 * score.tuned.played.late:.1f} %"
        cells = [f"{ours_ms:.1f}{late}"]
        for optimum, optimum_ms in score.optima_ms.items():
            above = (ours_ms - least_ms) / (optimum_ms - least_ms)
            cells += [f"{optimum_ms:.1f}", f"{ours_ms / optimum_ms:.3f}", f"{above:.3f}"]
            if f"{link} / {optimum}" in judged:
                benchmark.judge(f"{link} / {optimum}", ours_ms / optimum_ms)
        rows.append((link, *cells, str(score.default), str(score.warped)))
    gap = max(score.found_ms / score.optima_ms[MOVING] - 1 for score in scores)
    ratios = ("ours over it", "without smallest")
    benchmark.table(
        f"Mean delay in ms at {100 * LATE_TARGET:g} % late, delay free to change at once",
        ("link", "ours", CONSTANT, *ratios, MOVING, *ratios, "default", "default, 5 %"),
        rows,
        "Without smallest: after subtracting the trace's smallest delay. The best moving delay is a"
        f" lower bound; paths at most {100 * gap:.1f} % above it were found. Defaults: mean delay"
        " in ms / late frames in %, free to change at once and with a slew of at most 5 %.",
    )


def score_link(link: str, effort: Effort) -> LinkScore:
    """Compute the optima of a link, and our delay, tuned and at its default."""
    trace = links.make_trace(link, effort.seconds)
    delay_ms = trace.delay_ns / MS
    optimum = links.best_moving(delay_ms, LATE_TARGET)
    return LinkScore(
        float(delay_ms.min()),
        {CONSTANT: links.best_constant_ms(delay_ms, LATE_TARGET), MOVING: optimum.bound_ms},
        optimum.best.mean_ms,
        tune(trace, effort),
        play(DelayEstimator(LATE_TARGET, max_slew=math.inf), trace),
        play(DelayEstimator(LATE_TARGET), trace, warped=True),
    )


def tune(trace: DelayTrace, effort: Effort, permitted_late: float = LATE_TARGET) -> Tuned:
    """Tune the late target on a trace.

    Settings are tried evenly over the parameter's logarithm, then by bisection towards the
    permitted late share.
    """

    def tried_at(setting: float) -> PlayedTrace:
        return play(DelayEstimator(math.exp(setting), max_slew=math.inf), trace)

    few, many = math.log(FEWEST), math.log(MOST)
    scanned = [few + (many - few) * step / (effort.scan - 1) for step in range(effort.scan)]
    tried = [tried_at(setting) for setting in scanned]
    over = [number for number, played in enumerate(tried) if played.late > permitted_late]
    if over and over[0] > 0:
        few, many = scanned[over[0] - 1], scanned[over[0]]
        for _ in range(effort.bisections):
            middle = (few + many) / 2
            tried.append(tried_at(middle))
            if tried[-1].late <= permitted_late:
                few = middle
            else:
                many = middle
    within = [played for played in tried if played.late <= permitted_late]
    if within:
        return Tuned(min(within, key=lambda played: played.delay_ms), True)
    return Tuned(min(tried, key=lambda played: played.late), False)


def play(rule: DelayEstimator, trace: DelayTrace, warped: bool = False) -> PlayedTrace:
    """Play a trace by the delay that an estimator sets as the frames arrive.

    With `warped` the delay changes by at most 5 % of time, as in a display; otherwise at once.
    """
    arrived_ns = trace.arrived_ns.tolist()
    set_ns: list[int] = []
    for delay_ns, now_ns in zip(trace.delay_ns.tolist(), arrived_ns, strict=True):
        rule.observe(delay_ns, now_ns)
        set_ns.append(rule.delay_ns or 0)
    if warped:
        clock, before = PlayoutClock(), [set_ns[0], *set_ns]
        set_ns = [
            now_ns - clock.instant(now_ns, now_ns - before_ns)
            for now_ns, before_ns in zip(arrived_ns, before, strict=False)
        ]
        # With a slew, the delay in use until the next arrival is the one reached at that arrival.
        set_ns = [*set_ns[1:], set_ns[-1]]
    felt_ns = felt_delays_ns(trace, np.array(set_ns, dtype=np.int64))
    return PlayedTrace(float(felt_ns.mean()) * 1e-6, float((trace.delay_ns > felt_ns).mean()))


def felt_delays_ns(trace: DelayTrace, set_ns: Nanoseconds) -> Nanoseconds:
    """Return the delay at which each frame's instant was played, shape (frames,).

    set_ns[i] is the delay in use from arrival i until the next. Each instant is played once, as
    soon as its age reaches the delay in use. So a delay that grows because a frame came late cannot
    save that frame, and when the delay shrinks, the skipped instants are played at once.
    """
    arrived_ns = trace.arrived_ns
    # The newest instant played by the time of the next arrival.
    played_ns = np.maximum.accumulate(arrived_ns[1:] - set_ns[:-1])
    during = np.searchsorted(played_ns, trace.sent_ns)
    felt_ns: Nanoseconds = np.maximum(set_ns[during], arrived_ns[during] - trace.sent_ns)
    return felt_ns
