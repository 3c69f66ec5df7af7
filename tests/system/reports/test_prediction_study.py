import tomllib
from dataclasses import replace

import numpy as np
import pytest

from telepulse.reports.studies.prediction_pulses import RECORDED, WITHOUT_SHAPE_CUE, Pulse
from telepulse.reports.studies.prediction_report import (
    MEDIAN,
    TARGETS,
    PredictionTarget,
    TargetResult,
    compare_targets,
    report_prediction,
)
from telepulse.reports.studies.prediction_study import (
    HORIZONS_MS,
    PredictionEffort,
    PredictionScores,
    PredictorCost,
    cost,
    score,
)
from tests.support.nodes import ROOT

ANALOGUES = ("analogue 0.05 s", "analogue 0.2 s", "analogue 0.6 s")
NAMES = ("hold", "linear", *ANALOGUES, "analogue regression", "fir", "stack")
SETS = ("steady", "variability", "ramp", "ectopic", "fibrillation")


def made_up(error: float = 0.1) -> PredictionScores:
    errors = {name: (error,) * len(HORIZONS_MS) for name in NAMES}
    costs = {
        name: PredictorCost(1.0, 2.0, 5.0)
        for name in ("hold", "linear", "fir", "analogue", "stack")
    }
    return PredictionScores(
        dict.fromkeys((*SETS, *RECORDED), errors), dict.fromkeys(WITHOUT_SHAPE_CUE, errors), costs
    )


def sine(seconds: float, hertz: float = 1.0) -> Pulse:
    t_s = np.arange(round(seconds * 1000)) / 1000
    wave = np.sqrt(2) * np.sin(2 * np.pi * hertz * t_s)
    return Pulse("sine", wave, wave)


def test_hold_and_linear_score_the_theory_of_a_sine() -> None:
    errors = score(sine(24))
    assert tuple(errors) == NAMES
    for horizon_ms, found in zip(HORIZONS_MS, errors["hold"], strict=True):
        assert found == pytest.approx(2 * np.sin(np.pi * horizon_ms * 1e-3), rel=0.03)
    assert errors["linear"][0] < 0.2 * errors["hold"][0]
    assert max(errors["fir"]) < 0.02
    assert max(errors["stack"]) < 0.05


def test_a_learning_predictor_costs_more() -> None:
    sensed = sine(11).sensed
    hold, stack = cost("hold", sensed), cost("stack", sensed)
    assert 0 < hold.tick_p50_us <= hold.tick_p99_us
    assert stack.step_us > hold.step_us


def test_a_target_is_reached_within_its_allowance_at_every_horizon() -> None:
    target = PredictionTarget(MEDIAN, "stack", "prototype", (0.1, 0.1, None, 0.1))
    assert TargetResult(target, (0.1, 0.05, 9.0, 0.1049)).misses() == {}
    missed = TargetResult(target, (0.1, 0.12, 0.0, 0.1)).misses()
    assert missed == {"50 ms": pytest.approx(0.2)}
    strict = target._replace(allowance=0.0)
    assert list(TargetResult(strict, (0.1, 0.1001, 0.0, 0.1)).misses()) == ["50 ms"]


def test_every_target_is_judged_on_its_own_set() -> None:
    scores = made_up()
    scores.errors["ramp"] = scores.errors["ramp"] | {"stack": (9.0,) * len(HORIZONS_MS)}
    verdicts = compare_targets(scores.errors, scores.medians)
    assert [result.target for result in verdicts] == list(TARGETS)
    for result in verdicts:
        assert result.ours[0] == (9.0 if result.target.where == "ramp" else 0.1)
    without_medians = compare_targets(scores.errors_without_shape_cue, {})
    assert [result.target for result in without_medians] == [
        target for target in TARGETS if target.where != MEDIAN
    ]


def test_the_report_counts_reached_targets_and_gives_the_excess_of_others() -> None:
    chapter = report_prediction(made_up(), PredictionEffort()).chapters[1]
    rows = chapter.tables[0].rows
    assert len(rows) == len(TARGETS)
    goal = next(row for row in rows if row[0] == "variability" and row[2] == "stretch goal")
    assert goal[3:] == ("0.100 / –", "0.100 / –", "0.100 / 0.180", "0.100 / –", "reached")
    stack = next(row for row in rows if row[:2] == (MEDIAN, "stack"))
    assert stack[-1] == "missed: 20 ms +122 %"
    reached = sum(row[-1] == "reached" for row in rows)
    assert chapter.paragraphs[0].startswith(f"{reached} of {len(TARGETS)} rows")


def test_missing_recordings_are_named() -> None:
    scores, note = made_up(), "pip install 'telepulse[bench]' adds heartpy"
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert any("heartpy" in each for each in extras["optional-dependencies"]["bench"])
    fewer = replace(scores, errors={name: scores.errors[name] for name in SETS})
    for each, missing in ((scores, False), (fewer, True)):
        words = report_prediction(each, PredictionEffort()).chapters[0].paragraphs[0]
        assert (note in words) == missing
