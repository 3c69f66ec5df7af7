"""Conformance of predictors: pure, causal, and fast enough for each tick."""

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from display_node.prediction import Predictor
from display_node.prediction.scene import PredictorScene
from protocol.config.scene import validate
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.testing.conformance import call_within, read_table, require

TICK_NS = 1_000_000
FRAME = 5
LEARNS_S = 8.0
STEPS_AHEAD_MS = (1, 7, 20, 60, 150, 250, 1000)
# Shapes of the expected errors, and a horizon at which `error_n` is asked.
SHAPES = {"squares_n2": (25,), "in_phase_n2": (26, 26), "noticed": (26,)}
HORIZON_NS = 50 * TICK_NS
LARGEST_N = 1e3


def check_predictor(section: type[PredictorScene], keys: Mapping[str, Any]) -> None:
    """Check a kind of predictor on a synthetic pulse of 1 kHz.

    Predictions must be finite, the same when repeated, and depend on no sample that the predictor
    has not been given. An estimate of the error must be one, and no work take longer than a tick.
    """
    table = read_table(section, keys)
    pulse_n = _pulse(LEARNS_S)
    first = _build(table, 1)[0]
    require(first.predict(0) == 0.0, "a prediction before any sample is not 0")
    began_s = time.process_time()
    _play([first], pulse_n)
    busy_s = (time.process_time() - began_s) / len(pulse_n)
    require(
        busy_s < TICK_NS * 1e-9,
        f"observing and predicting takes {busy_s * 1e3:.2f} ms of each tick of 1 ms",
    )
    predicted_n = _predictions(first, len(pulse_n))
    again_n = _predictions(first, len(pulse_n), backwards=True)
    require(predicted_n == again_n, "predict changes later predictions: it must not keep anything")
    other = _build(table, 1)[0]
    _play([other], pulse_n, overwrite=True)
    require(
        _predictions(other, len(pulse_n)) == predicted_n,
        "it looks ahead: its predictions follow the lists that observe was given, after the caller"
        " had written later samples into them (copy what is kept)",
    )
    _check_instances(table, pulse_n, predicted_n)
    _check_error(table, first)
    _play(_build(table, 3), pulse_n[: 100 * FRAME])
    _check_extremes(_build(table, 1)[0])


def _check_instances(table: PredictorScene, pulse_n: list[float], predicted_n: list[float]) -> None:
    """Check that what one predictor is given does not reach another."""
    ahead, later = _build(table, 1)[0], _build(table, 1)[0]
    _play([ahead], [*pulse_n, *(1.0 + each for each in pulse_n[:500])])
    _play([later], pulse_n)
    require(
        _predictions(later, len(pulse_n)) == predicted_n,
        "it looks ahead: predictions depend on later samples that another predictor was given",
    )


def _check_error(table: PredictorScene, predictor: Predictor) -> None:
    error_n, expected = predictor.error_n(HORIZON_NS), predictor.expected
    require(
        error_n is None or (math.isfinite(error_n) and error_n >= 0),
        f"error_n returns {error_n}, not a finite error or None",
    )
    require(
        not table.estimates_error or (expected is not None and error_n is not None),
        f"estimates_error is true, and after {LEARNS_S:g} s of a regular pulse there is none",
    )
    if expected is None:
        return
    for name, shape in SHAPES.items():
        values = np.asarray(getattr(expected, name))
        require(
            values.shape == shape and bool((values >= 0).all()),
            f"expected.{name} has the shape {values.shape}, or values below 0: it must have the"
            f" shape {shape}, and none",
        )


def _check_extremes(predictor: Predictor) -> None:
    """Check predictions after a step, a gap, and samples that come late."""
    for first, level_n in ((0, 0.0), (200, LARGEST_N), (150, -LARGEST_N), (3_000, 0.3)):
        times_ns = [(first + number) * TICK_NS for number in range(FRAME)]
        predictor.observe(times_ns, [level_n] * FRAME)
        predictor.work()
        _predictions(predictor, max(first, 200) + FRAME)


def _build(table: PredictorScene, count: int) -> Sequence[Predictor]:
    found = call_within(10.0, "build", lambda: table.build(TICK_NS, count))
    require(len(found) == count, f"build returns {len(found)} predictors for {count} channels")
    return found


def _play(predictors: Sequence[Predictor], pulse_n: list[float], overwrite: bool = False) -> None:
    """Give each channel the same pulse, frame by frame, as a display does.

    overwrite: write later samples into the lists that a predictor was given.
    """
    for first in range(0, len(pulse_n), FRAME):
        frame_n = pulse_n[first : first + FRAME]
        for predictor in predictors:
            values = list(frame_n)
            times_ns = [(first + number) * TICK_NS for number in range(len(values))]
            predictor.observe(times_ns, values)
            if overwrite:
                times_ns[:] = [each + len(values) * TICK_NS for each in times_ns]
                values[:] = [each + 1.0 for each in values]
        for _ in frame_n:
            for predictor in predictors:
                predictor.work()


def _predictions(predictor: Predictor, samples: int, backwards: bool = False) -> list[float]:
    """Return the predictions at some times after the newest of these samples."""
    steps = STEPS_AHEAD_MS[::-1] if backwards else STEPS_AHEAD_MS
    found = {step: predictor.predict((samples - 1 + step) * TICK_NS) for step in steps}
    for step, value in found.items():
        require(
            isinstance(value, float) and math.isfinite(value),
            f"the prediction {step} ms after the newest sample is {value!r}",
        )
    return [found[step] for step in STEPS_AHEAD_MS]


def _pulse(seconds: float) -> list[float]:
    scene = validate({"kind": "synthetic", "noise": "1 mN"}, SyntheticScene, "")
    samples = SyntheticSource(scene).take(round(seconds * 1e9 / TICK_NS))
    pulse_n: list[float] = samples[:, 0].tolist()
    return pulse_n
