import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from telepulse.cli.main import app
from telepulse.reports.document import THEMES
from telepulse.reports.studies import prediction_scores
from telepulse.reports.studies.prediction_pulses import RECORDED, SILENT, Pulse
from telepulse.reports.studies.prediction_report import (
    MEDIAN,
    TARGETS,
    PredictionTarget,
    TargetResult,
    compare_targets,
    missing_sets,
    report_prediction,
)
from telepulse.reports.studies.prediction_scores import (
    HORIZONS_MS,
    PredictionEffort,
    PredictionScores,
    PredictorCost,
    cost,
    score,
)

NAMES = (
    "hold",
    "linear",
    "analogue 0.05 s",
    "analogue 0.2 s",
    "analogue 0.6 s",
    "fir",
    "harmonic",
    "stack",
)
SETS = ("steady", "variability", "ramp", "ectopic", "fibrillation")


def made_up(error: float = 0.1) -> PredictionScores:
    errors = {name: (error,) * len(HORIZONS_MS) for name in NAMES}
    costs = {
        name: PredictorCost(1.0, 2.0, 5.0)
        for name in ("hold", "linear", "fir", "analogue", "harmonic", "stack")
    }
    return PredictionScores(
        dict.fromkeys((*SETS, *RECORDED), errors), dict.fromkeys(SILENT, errors), costs
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


def test_a_bar_is_reached_within_its_allowance_at_every_horizon() -> None:
    bar = PredictionTarget(MEDIAN, "stack", "prototype", (0.1, 0.1, None, 0.1))
    assert TargetResult(bar, (0.1, 0.05, 9.0, 0.1049)).reached
    missed = TargetResult(bar, (0.1, 0.12, 0.0, 0.1))
    assert not missed.reached
    assert missed.excess(1) == pytest.approx(0.2)
    assert missed.excess(2) is None
    assert not TargetResult(replace(bar, allowance=0.0), (0.1, 0.1001, 0.0, 0.1)).reached


def test_every_bar_is_judged_on_its_own_set() -> None:
    scores = made_up()
    scores.errors["ramp"] = scores.errors["ramp"] | {"stack": (9.0,) * len(HORIZONS_MS)}
    verdicts = compare_targets(scores.errors, scores.medians)
    assert [result.target for result in verdicts] == list(TARGETS)
    assert {result.ours[0] for result in verdicts if result.target.where == "ramp"} == {9.0}
    assert {result.ours[0] for result in verdicts if result.target.where != "ramp"} == {0.1}


def test_without_medians_only_sets_are_judged() -> None:
    judged = compare_targets(made_up().silent_errors, {})
    assert [result.target for result in judged] == [
        target for target in TARGETS if target.where != MEDIAN
    ]


def test_the_report_counts_reached_targets_and_gives_the_excess_of_others() -> None:
    table = report_prediction(made_up(), PredictionEffort()).chapters[1].tables[0]
    assert len(table.rows) == len(TARGETS)
    prize = next(row for row in table.rows if row[0] == "variability" and row[2] == "prize")
    assert prize[3:] == ("0.100 / –", "0.100 / –", "0.100 / 0.180", "0.100 / –", "reached")
    stack = next(row for row in table.rows if row[:2] == (MEDIAN, "stack"))
    assert stack[-1] == "missed: 20 ms +122%"
    reached = sum(row[-1] == "reached" for row in table.rows)
    text = report_prediction(made_up(), PredictionEffort()).chapters[1].paragraphs[0]
    assert text.startswith(f"{reached} of {len(TARGETS)} rows")


def test_missing_recordings_are_named() -> None:
    scores = made_up()
    assert missing_sets(scores) == ""
    fewer = replace(scores, errors={name: scores.errors[name] for name in SETS})
    assert "pip install 'telepulse[test]'" in missing_sets(fewer)
    assert (
        missing_sets(fewer)
        in report_prediction(fewer, PredictionEffort()).chapters[0].paragraphs[0]
    )


def test_the_command_prints_its_tables_and_writes_page_pictures_and_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(prediction_scores, "score_predictors", lambda *_: made_up())
    table = tmp_path / "tables.json"
    result = CliRunner().invoke(
        app, ["study", "prediction", "--out", str(tmp_path / "new"), "--json", str(table)]
    )
    assert result.exit_code == 0, result.output
    assert result.output.endswith(f"report: {tmp_path / 'new' / 'index.html'}\n")
    for name in ("error-horizon", "cost-error"):
        for theme in THEMES:
            picture = (tmp_path / "new" / f"{name}-{theme.name}.png").read_bytes()
            assert picture.startswith(b"\x89PNG")
    written = json.loads(table.read_text(encoding="utf-8"))
    assert [row["predictor"] for row in written["chapters"][0]["tables"][0]["rows"]] == list(NAMES)
