"""Errors and costs of the predictors, driven as a display drives them: by frames and ticks."""

import statistics
import time
from dataclasses import dataclass
from typing import get_args

import numpy as np

from display_node.prediction import Predictor, PredictorName, build_predictor
from display_node.prediction.ensemble import Ensemble
from telepulse.reports.studies.prediction_pulses import (
    RATE_HZ,
    SCORED_FROM_S,
    Floats,
    Pulse,
    pulses,
    silent_pulses,
)
from telepulse.reports.studies.sweep import in_one_thread, sweep

HORIZONS_MS = (20, 50, 100, 200)
TICK_NS = 1_000_000
# A frame has 5 samples, one a tick; the sensing clock begins at an arbitrary time.
FRAME = 5
BEGIN_NS = 3_600_000_000_000
# Earlier ticks are a predictor's warm-up, which costs less.
COSTLY_FROM_S = 10.0
Errors = dict[str, tuple[float, ...]]
CHEAP: tuple[PredictorName, ...] = ("hold", "linear")


@dataclass(frozen=True, slots=True)
class PredictionEffort:
    """Amount of computing. The defaults are the study's; tests use less."""

    seconds: float = 60.0
    cost_seconds: float = 25.0
    seed: int = 1


@dataclass(frozen=True, slots=True)
class PredictorCost:
    """Processor time in µs of a tick, and of a step: all the work on 5 ms of samples."""

    tick_p50_us: float
    tick_p99_us: float
    step_us: float


@dataclass(frozen=True, slots=True)
class PredictionScores:
    """NRMSE at each horizon by set and predictor, and costs by the predictor's name in a scene.

    silent_errors holds the same errors where a beat's shape does not predict its interval.
    """

    errors: dict[str, Errors]
    silent_errors: dict[str, Errors]
    costs: dict[str, PredictorCost]

    @property
    def medians(self) -> dict[str, tuple[float, ...]]:
        """Medians over the sets, by predictor."""
        sets = list(self.errors.values())
        return {
            name: tuple(
                statistics.median(errors[name][at] for errors in sets)
                for at in range(len(HORIZONS_MS))
            )
            for name in sets[0]
        }


def score_predictors(effort: PredictionEffort, scheduler: str | None = None) -> PredictionScores:
    """Score all predictors on all sets, on all cores or a Dask cluster; then measure costs here.

    Raises SourceError or SweepError.
    """
    sets = pulses(effort.seconds, effort.seed)
    silent = silent_pulses(effort.seconds, effort.seed)
    found = sweep(score, sets + silent, scheduler)
    errors, silent_errors = (
        {pulse.name: errors for pulse, errors in zip(part, scored, strict=True)}
        for part, scored in ((sets, found[: len(sets)]), (silent, found[len(sets) :]))
    )
    # Alone on the machine, after the others have ended.
    costs = in_one_thread(all_costs, sets[1].sensed[: round(effort.cost_seconds * RATE_HZ)])
    return PredictionScores(errors, silent_errors, costs)


def all_costs(sensed: Floats) -> dict[str, PredictorCost]:
    """Measure the cost of each predictor that a scene can name, one after the other."""
    return {name: cost(name, sensed) for name in get_args(PredictorName)}


def score(pulse: Pulse) -> Errors:
    """Return the NRMSE of hold, linear, the stack and each of its experts, after `SCORED_FROM_S`.

    The RMSE is against the pulse without noise, over its standard deviation. Each frame is
    predicted from once, at each horizon after its newest sample, at its five ticks in turn.
    """
    stack = Ensemble("stack", TICK_NS)
    cheap = [build_predictor(name, TICK_NS) for name in CHEAP]
    names = (*CHEAP, *stack.names)
    squares = np.zeros((len(HORIZONS_MS), len(names)))
    counts = np.zeros((len(HORIZONS_MS), 1))
    first_frame = round(SCORED_FROM_S * RATE_HZ) // FRAME
    for frame in range(len(pulse.sensed) // FRAME):
        for predictor in (stack, *cheap):
            _observe(predictor, pulse.sensed, frame)
        for tick in range(FRAME):
            stack.work()
            if frame >= first_frame and tick == frame % FRAME:
                newest = frame * FRAME + FRAME - 1
                for row, horizon_ms in enumerate(HORIZONS_MS):
                    at = newest + horizon_ms * RATE_HZ // 1000
                    if at < len(pulse.true):
                        instant_ns = _instant_ns(at)
                        found = [each.predict(instant_ns) for each in cheap]
                        found += stack.predict_each(instant_ns)
                        squares[row] += (np.array(found) - pulse.true[at]) ** 2
                        counts[row] += 1
    errors = np.sqrt(squares / counts)
    return {name: tuple(errors[:, column].tolist()) for column, name in enumerate(names)}


def cost(name: PredictorName, sensed: Floats) -> PredictorCost:
    """Measure the processor time of a predictor that predicts once a tick, as in a display."""
    predictor = build_predictor(name, TICK_NS)
    taken_us = []
    for frame in range(len(sensed) // FRAME):
        for tick in range(FRAME):
            began_ns = time.thread_time_ns()
            if tick == 0:
                _observe(predictor, sensed, frame)
            predictor.work()
            predictor.predict(_instant_ns(frame * FRAME + FRAME + 49))
            taken_us.append((time.thread_time_ns() - began_ns) * 1e-3)
    costly = np.array(taken_us[round(COSTLY_FROM_S * RATE_HZ) :])
    median, high = np.percentile(costly, [50, 99]).tolist()
    return PredictorCost(median, high, float(costly.mean()) * FRAME)


def _observe(predictor: Predictor, sensed: Floats, frame: int) -> None:
    first = frame * FRAME
    times_ns = [_instant_ns(number) for number in range(first, first + FRAME)]
    predictor.observe(times_ns, sensed[first : first + FRAME].tolist())


def _instant_ns(sample: int) -> int:
    return BEGIN_NS + sample * (1_000_000_000 // RATE_HZ)
