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

SEED = 1
# Costs are measured after this time: while a predictor warms up, a tick costs less.
COSTLY_FROM_S = 10.0
CHEAP: tuple[PredictorName, ...] = ("hold", "linear")
HORIZONS = tuple(f"{each} ms" for each in HORIZONS_MS)
MEDIAN = "median"
# Of the analogues, the one with the shortest memory has the least error at most horizons.
ANALOGUE = "analogue 0.05 s"
Errors = dict[str, tuple[float, ...]]


class Reference(NamedTuple):
    """Errors beside ours, at each horizon; None: none is known."""

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
    sets, silent = (make(seconds, SEED) for make in (pulses, pulses_without_shape_cue))
    if benchmark.quick:
        sets, silent = sets[:2], silent[:1]
    found = iter(benchmark.run(score, sets + silent))
    errors, cued_not = ({each.name: next(found) for each in part} for part in (sets, silent))
    errors |= {MEDIAN: _medians(errors)}
    _show_errors(benchmark, errors)
    _compare(benchmark, "Beside a prototype", errors, judge=not benchmark.quick)
    _compare(benchmark, "The same where no shape predicts the next beat", cued_not, judge=False)
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


def _show_errors(benchmark: Benchmark, errors: Mapping[str, Errors]) -> None:
    medians = errors[MEDIAN]
    missing = set() if benchmark.quick else set(RECORDED) - set(errors)
    benchmark.table(
        f"NRMSE after {SCORED_FROM_S:g} s, median over {len(errors) - 1} pulses",
        ("predictor", *HORIZONS),
        [(name, *_cells(each)) for name, each in medians.items()],
        f"Without {', '.join(sorted(missing))}: heartpy is not installed." if missing else "",
    )
    benchmark.table(
        "The stack's NRMSE by pulse",
        ("pulse", *HORIZONS),
        [(name, *_cells(each["stack"])) for name, each in errors.items() if name != MEDIAN],
    )


def _compare(benchmark: Benchmark, title: str, errors: Mapping[str, Errors], judge: bool) -> None:
    """Print ours / the reference's errors; with `judge`, judge the greatest ratio of each."""
    rows = []
    for reference in REFERENCES:
        if reference.pulse not in errors:
            continue
        pairs = list(
            zip(errors[reference.pulse][reference.predictor], reference.errors, strict=True)
        )
        cells = [f"{ours:.3f} / {theirs or '–'}" for ours, theirs in pairs]
        rows.append((reference.pulse, reference.predictor, reference.source, *cells))
        if judge:
            benchmark.judge(str(reference), max(o / t for o, t in pairs if t is not None))
    benchmark.table(title, ("pulse", "predictor", "beside", *HORIZONS), rows)


def score(pulse: Pulse) -> Errors:
    """Return the NRMSE of hold, linear, the stack and each of its experts, after `SCORED_FROM_S`.

    The RMS is against the pulse without noise, over its standard deviation. After each frame,
    one prediction is made for each horizon, counted from the newest sample. It is made at the
    first to the fifth tick after the frame in turn.
    """
    stack = Ensemble("stack")
    cheap = [build_predictors(name)[0] for name in CHEAP]
    names = (*CHEAP, *stack.names)
    squares = np.zeros((len(HORIZONS_MS), len(names)))
    counts = np.zeros((len(HORIZONS_MS), 1))
    first_frame = round(SCORED_FROM_S * RATE_HZ) // FRAME
    for frame in range(len(pulse.sensed) // FRAME):
        for predictor in (stack, *cheap):
            observe_frame(predictor, pulse.sensed, frame)
        for tick in range(FRAME):
            stack.work()
            if frame < first_frame or tick != frame % FRAME:
                continue
            for row, horizon_ms in enumerate(HORIZONS_MS):
                at = frame * FRAME + FRAME - 1 + horizon_ms * RATE_HZ // 1000
                if at < len(pulse.true):
                    at_ns = instant_ns(at)
                    found = [each.predict(at_ns) for each in cheap]
                    found += stack.predict_each(at_ns)
                    squares[row] += (np.array(found) - pulse.true[at]) ** 2
                    counts[row] += 1
    errors = np.sqrt(squares / counts)
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
