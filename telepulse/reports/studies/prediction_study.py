"""The study of predictors: errors, costs, and a prototype's figures as targets.

The predictors are driven as a display drives them, by frames and ticks.
"""

import statistics
import time
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeVar, get_args

import numpy as np

from display_node.prediction import PredictorName, build_predictors
from display_node.prediction.ensemble import Ensemble
from telepulse.parallel import in_one_thread, sweep
from telepulse.reports.studies.prediction_oracle import (
    best_filter_errors,
    known_rhythms,
    oracle_errors,
)
from telepulse.reports.studies.prediction_pulses import (
    RATE_HZ,
    SCORED_FROM_S,
    Floats,
    Pulse,
    pulses,
    pulses_without_shape_cue,
)

HORIZONS_MS = (20, 50, 100, 200)
TICK_NS = 1_000_000
# A frame has 5 samples, one for each tick; the sensing clock begins at an arbitrary time.
FRAME = 5
BEGIN_NS = 3_600_000_000_000
# Costs are measured after this time: while a predictor warms up, a tick costs less.
COSTLY_FROM_S = 10.0
# A beat is visible to the oracle from 1, 4 or 14 % of its first wave's height on.
VISIBLE_WIDTHS = (3.0, 2.5, 2.0)
CHEAP: tuple[PredictorName, ...] = ("hold", "linear")
Errors = dict[str, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class PredictionEffort:
    """Amount of computing. The defaults are the study's; tests use less."""

    seconds: float = 60.0
    cost_seconds: float = 25.0
    seed: int = 1


Found = TypeVar("Found", covariant=True)


class SampleObserver(Protocol[Found]):
    """What takes a frame's samples."""

    def observe(self, times_ns: list[int], values: list[float]) -> Found:
        """Take the samples."""


class PredictorCost(NamedTuple):
    """Processor time in µs of a tick, and of a step: all the work on 5 ms of samples."""

    tick_p50_us: float
    tick_p99_us: float
    step_us: float


@dataclass(frozen=True, slots=True)
class PredictionScores:
    """NRMSE at each horizon by set and predictor, and costs by the predictor's name in a scene.

    errors_without_shape_cue holds the errors on pulses whose beats' shapes predict no interval;
    oracle, those of an oracle on two of them, by set and by the widths at which it sees a beat;
    best_filter, the medians over the sets of the errors of the best fixed linear filter.
    """

    errors: dict[str, Errors]
    errors_without_shape_cue: dict[str, Errors]
    costs: dict[str, PredictorCost]
    oracle: dict[tuple[str, float], tuple[float, ...]] = field(default_factory=dict)
    best_filter: tuple[float, ...] = ()

    @property
    def medians(self) -> Errors:
        """Medians over the sets, by predictor."""
        sets = list(self.errors.values())
        by_horizon = {
            name: zip(*(errors[name] for errors in sets), strict=True) for name in sets[0]
        }
        return {name: tuple(map(statistics.median, each)) for name, each in by_horizon.items()}


def score_predictors(effort: PredictionEffort, scheduler: str | None = None) -> PredictionScores:
    """Score all predictors on all sets, on all cores or a Dask cluster; then measure costs here.

    Raises SourceError or SweepError.
    """
    sets = pulses(effort.seconds, effort.seed)
    silent = pulses_without_shape_cue(effort.seconds, effort.seed)
    found = iter(sweep(score, sets + silent, scheduler))
    errors, errors_without_shape_cue = (
        {each.name: next(found) for each in part} for part in (sets, silent)
    )
    # Measured after all other cases have ended, so that nothing else runs.
    costs = in_one_thread(all_costs, sets[1].sensed[: round(effort.cost_seconds * RATE_HZ)])
    oracle = {
        (name, widths): oracle_errors(rhythm, effort.seconds, widths, HORIZONS_MS)
        for name, rhythm in known_rhythms(effort.seconds, effort.seed).items()
        for widths in VISIBLE_WIDTHS
    }
    filters = in_one_thread(best_filters, sets)
    return PredictionScores(errors, errors_without_shape_cue, costs, oracle, filters)


def best_filters(sets: list[Pulse]) -> tuple[float, ...]:
    """Return the medians over the sets of the best fixed linear filter's errors."""
    errors = [best_filter_errors(pulse, HORIZONS_MS) for pulse in sets]
    return tuple(map(statistics.median, zip(*errors, strict=True)))


def all_costs(sensed: Floats) -> dict[str, PredictorCost]:
    """Measure the cost of each predictor that a scene can name, one after the other."""
    return {name: cost(name, sensed) for name in get_args(PredictorName)}


def score(pulse: Pulse) -> Errors:
    """Return the NRMSE of hold, linear, the stack and each of its experts, after `SCORED_FROM_S`.

    The RMSE is against the pulse without noise, over its standard deviation. After each frame,
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


def observe_frame(observer: SampleObserver[Found], sensed: Floats, frame: int) -> Found:
    """Give a frame's samples to a predictor or detector."""
    samples = range(frame * FRAME, frame * FRAME + FRAME)
    values = sensed[samples.start : samples.stop].tolist()
    return observer.observe([instant_ns(number) for number in samples], values)


def instant_ns(sample: int) -> int:
    """Return the time of a sample on the sensing clock."""
    return BEGIN_NS + sample * (1_000_000_000 // RATE_HZ)
