"""Errors of the predictors by the time ahead, and their cost, on drawn pulses and recordings.

The predictors are driven as a display drives them, by frames and ticks.
"""

import statistics
import time
from collections.abc import Mapping
from typing import NamedTuple, get_args

import numpy as np

from benchmarks.benchmark import Benchmark
from display_node.prediction import PredictorName, build_predictors
from display_node.prediction.ensemble import Ensemble
from telepulse.parallel import in_one_thread
from tests.support.drawn_pulses import (
    BEGIN_NS,
    FRAME,
    HORIZONS_MS,
    RATE_HZ,
    RECORDED,
    SCORED_FROM_S,
    Floats,
    Pulse,
    instant_ns,
    observe_frame,
    pulses,
    pulses_without_shape_cue,
)
from tests.support.finger_pulses import finger_pulses
from tests.support.people_pulses import people_pulses

SEED = 1
# Costs are measured after this time: while a predictor warms up, a tick costs less.
COSTLY_FROM_S = 10.0
CHEAP: tuple[PredictorName, ...] = ("hold", "linear")
AHEAD_MS = (10, *HORIZONS_MS)
HORIZONS = tuple(f"{each} ms" for each in AHEAD_MS)
MEDIAN = "median"
# Of the analogues, the one with the shortest memory has the least error at most horizons.
ANALOGUE = "analogue 0.05 s"
Errors = dict[str, tuple[float, ...]]


class Reference(NamedTuple):
    """Errors beside ours, at each of `HORIZONS_MS`; None: none is known."""

    pulse: str
    predictor: str
    source: str
    errors: tuple[float | None, ...]

    def __str__(self) -> str:
        return f"{self.pulse}, {self.predictor}: over {self.source}"


# An earlier prototype's errors on pulses of these names, its oracle's, and goals beyond them.
REFERENCES = (
    Reference(MEDIAN, "stack", "prototype", (0.045, 0.156, 0.321, 0.394)),
    Reference(MEDIAN, ANALOGUE, "prototype", (0.070, 0.206, 0.379, 0.433)),
    Reference(MEDIAN, "fir", "prototype", (0.055, 0.207, 0.486, 0.537)),
    Reference(MEDIAN, "hold", "prototype", (0.307, 0.715, 1.21, 1.54)),
    Reference("variability", "stack", "prototype", (0.027, 0.078, 0.214, 0.295)),
    Reference("variability", "stack", "its oracle", (0.021, 0.064, 0.142, 0.167)),
    Reference("variability", "stack", "goal", (None, None, 0.18, None)),
    Reference("ramp", "stack", "prototype", (0.036, 0.099, 0.192, 0.218)),
    Reference("ramp", "stack", "its oracle", (0.009, 0.025, 0.050, 0.059)),
    Reference("ramp", "stack", "goal", (None, None, 0.12, None)),
    Reference("ectopic", "stack", "prototype", (0.033, 0.093, 0.254, 0.341)),
    Reference("ectopic", "stack", "its oracle", (0.021, 0.065, 0.167, 0.249)),
    Reference("fibrillation", "stack", "prototype", (0.045, 0.159, 0.505, 0.776)),
    Reference("fibrillation", "stack", "its oracle", (0.045, 0.158, 0.528, 0.787)),
)


class PredictorCost(NamedTuple):
    """Processor time in µs of a tick, and of a step: all the work on 5 ms of samples."""

    tick_p50_us: float
    tick_p99_us: float
    step_us: float


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    seconds = 21.0 if benchmark.quick else 60.0
    makes = pulses, pulses_without_shape_cue, finger_pulses, people_pulses
    sets, silent, fingers, people = (make(seconds, SEED) for make in makes)
    if benchmark.quick:
        sets, silent, fingers = sets[:2], silent[:1], fingers[:1]
        people = [pulse for pulse in people if np.isnan(pulse.sensed).any()]
    found = iter(benchmark.run(score, sets + silent + fingers + people))
    errors, cued_not, finger_errors, people_errors = (
        {each.name: next(found) for each in part} for part in (sets, silent, fingers, people)
    )
    errors |= {MEDIAN: _medians(errors)}
    missing = set() if benchmark.quick else set(RECORDED) - set(errors)
    _show_medians(
        benchmark,
        f"{len(errors) - 1} pulses",
        errors[MEDIAN],
        f"Without {', '.join(sorted(missing))}: heartpy is not installed." if missing else "",
    )
    medians = _medians(people_errors)
    _show_medians(benchmark, f"{len(people_errors)} pulses of people", medians)
    all_errors = {name: each for name, each in errors.items() if name != MEDIAN}
    all_errors |= {f"{name}, no shape cue": each for name, each in cued_not.items()}
    all_errors |= finger_errors | people_errors
    worst = map(max, zip(*(each["stack"] for each in people_errors.values()), strict=True))
    benchmark.table(
        "The stack's NRMSE by pulse",
        ("pulse", *HORIZONS),
        [
            *((name, *_cells(each["stack"])) for name, each in all_errors.items()),
            ("median of people", *_cells(medians["stack"])),
            ("worst of people", *_cells(tuple(worst))),
        ],
    )
    _compare_members(benchmark, all_errors)
    if not benchmark.quick:
        _judge_references(benchmark, errors)
    # Measured after all other cases have ended, so that nothing else runs.
    cost_seconds = COSTLY_FROM_S + (1.0 if benchmark.quick else 15.0)
    costs = in_one_thread(all_costs, sets[1].sensed[: round(cost_seconds * RATE_HZ)])
    benchmark.table(
        "Processor time in µs at ticks of 1 ms",
        ("predictor", "tick p50", "tick p99", "5 ms of samples"),
        [(name, *(f"{each:.1f}" for each in cost)) for name, cost in costs.items()],
    )
    benchmark.judge("tick of the stack, 99th percentile", costs["stack"].tick_p99_us * 1e-6)


def _medians(errors: Mapping[str, Errors]) -> Errors:
    """Return the medians over the sets, by predictor."""
    sets = list(errors.values())
    by_horizon = {name: zip(*(each[name] for each in sets), strict=True) for name in sets[0]}
    return {name: tuple(map(statistics.median, each)) for name, each in by_horizon.items()}


def _cells(errors: tuple[float, ...]) -> tuple[str, ...]:
    return tuple(f"{error:.3f}" for error in errors)


def _show_medians(benchmark: Benchmark, over: str, medians: Errors, note: str = "") -> None:
    benchmark.table(
        f"NRMSE after {SCORED_FROM_S:g} s, median over {over}",
        ("predictor", *HORIZONS),
        [(name, *_cells(each)) for name, each in medians.items()],
        note,
    )


def _compare_members(benchmark: Benchmark, errors: Mapping[str, Errors]) -> None:
    """Print the stack's errors over those of its best member, hold and linear included."""
    ratios = {}
    for name, each in errors.items():
        members = zip(*(found for member, found in each.items() if member != "stack"), strict=True)
        ratios[name] = tuple(
            stack / min(found) for stack, found in zip(each["stack"], members, strict=True)
        )
    by_horizon = list(zip(*ratios.values(), strict=True))
    names = list(ratios)
    worst = [names[each.index(max(each))] for each in by_horizon]
    benchmark.table(
        "The stack's NRMSE over that of its best member",
        ("of the pulses", *HORIZONS),
        [
            ("median", *_cells(tuple(map(statistics.median, by_horizon)))),
            ("worst", *_cells(tuple(map(max, by_horizon)))),
            ("which is", *worst),
        ],
    )
    benchmark.judge("stack over its best member, worst", max(map(max, ratios.values())))


def _judge_references(benchmark: Benchmark, errors: Mapping[str, Errors]) -> None:
    """Judge the greatest ratio of our errors over those of each reference."""
    for reference in REFERENCES:
        ours = dict(zip(AHEAD_MS, errors[reference.pulse][reference.predictor], strict=True))
        pairs = zip(HORIZONS_MS, reference.errors, strict=True)
        ratios = [ours[ahead_ms] / theirs for ahead_ms, theirs in pairs if theirs is not None]
        benchmark.judge(str(reference), max(ratios))


def score(pulse: Pulse) -> Errors:
    """Return the NRMSE of hold, linear, the stack and each of its experts, after `SCORED_FROM_S`.

    The RMS is against the pulse without noise, over its standard deviation. After each frame and
    all work on it, one prediction is made for each horizon, counted from the newest sample. Samples
    that are lost are not given to the predictors; after a frame without any, nothing is predicted.
    """
    stack = Ensemble("stack")
    cheap = [build_predictors(name)[0] for name in CHEAP]
    names = (*CHEAP, *stack.names)
    times_ns = BEGIN_NS + np.round(np.arange(len(pulse.sensed)) / pulse.rate_hz * 1e9).astype(int)
    ahead_ns = np.array(AHEAD_MS) * 1_000_000
    squares, count = np.zeros((len(AHEAD_MS), len(names))), 0
    for first in range(0, len(pulse.sensed) - pulse.frame + 1, pulse.frame):
        arrived = first + np.flatnonzero(np.isfinite(pulse.sensed[first : first + pulse.frame]))
        if not len(arrived):
            continue
        for predictor in (stack, *cheap):
            predictor.observe(times_ns[arrived].tolist(), pulse.sensed[arrived].tolist())
        while stack.work():
            pass
        newest_ns = times_ns[arrived[-1]]
        at_ns = newest_ns + ahead_ns
        if newest_ns < BEGIN_NS + SCORED_FROM_S * 1e9 or at_ns[-1] > times_ns[-1]:
            continue
        true = np.interp(at_ns, times_ns, pulse.true)
        for row, instant in enumerate(at_ns.tolist()):
            found = [each.predict(instant) for each in cheap] + stack.predict_each(instant)
            squares[row] += (np.array(found) - true[row]) ** 2
        count += 1
    errors = np.sqrt(squares / count) / pulse.true[times_ns >= BEGIN_NS + SCORED_FROM_S * 1e9].std()
    return {name: tuple(errors[:, column].tolist()) for column, name in enumerate(names)}


def all_costs(sensed: Floats) -> dict[str, PredictorCost]:
    """Measure the cost of each predictor that a scene can name, one after the other."""
    return {name: cost(name, sensed) for name in get_args(PredictorName)}


def cost(name: PredictorName, sensed: Floats) -> PredictorCost:
    """Measure the processor time of a predictor that predicts once per tick, as in a display."""
    predictor = build_predictors(name)[0]
    taken_us = []
    for frame in range(len(sensed) // FRAME):
        for tick in range(FRAME):
            began_ns = time.thread_time_ns()
            if tick == 0:
                observe_frame(predictor, sensed, frame)
            predictor.work()
            predictor.predict(instant_ns(frame * FRAME + FRAME + 49))
            taken_us.append((time.thread_time_ns() - began_ns) * 1e-3)
    costly = np.array(taken_us[round(COSTLY_FROM_S * RATE_HZ) :])
    median, high = np.percentile(costly, [50, 99]).tolist()
    return PredictorCost(median, high, float(costly.mean()) * FRAME)
