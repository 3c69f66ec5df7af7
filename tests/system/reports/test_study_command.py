import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from telepulse.cli.main import app
from telepulse.reports.studies import (
    cost_scores,
    integrator_scores,
    link_scores,
    playout_scores,
    prediction_study,
    sweep,
)
from telepulse.reports.studies.link_scores import PREDICTORS, LinkSpec
from telepulse.reports.studies.playout_links import GAUSSIAN
from tests.system.reports import test_cost_study
from tests.system.reports.test_prediction_study import made_up

SWEPT = ("playout", "prediction", "link", "cost")


def study(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["study", *map(str, arguments)])


def little_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each study do a little of its work."""
    alone, links, playout = (
        sweep.in_one_thread,
        link_scores.score_links,
        playout_scores.score_playout,
    )
    integrators = integrator_scores.IntegratorEffort(
        seconds=0.1, rounds=1, substeps=(1,), solvers=(), rotor_seconds=0.02
    )
    link = link_scores.LinkEffort(seconds=1, settle_seconds=1, seeds=(1,), links=("far",))
    far = LinkSpec("delay=40ms,jitter=1ms", (0.0, 80.0))
    play = playout_scores.PlayoutEffort(
        seconds=3, scan=2, bisections=1, links=(GAUSSIAN,), curves=(GAUSSIAN,)
    )
    costs, cost = cost_scores.score_costs, test_cost_study.LITTLE
    monkeypatch.setattr(cost_scores, "score_costs", lambda _, address: costs(cost, address))
    monkeypatch.setattr(sweep, "in_one_thread", lambda work, _: alone(work, integrators))
    monkeypatch.setattr(link_scores, "pulses", lambda *_, **__: [])
    monkeypatch.setitem(link_scores.LINKS, "far", far)
    monkeypatch.setattr(link_scores, "score_links", lambda _, address: links(link, address))
    monkeypatch.setattr(playout_scores, "score_playout", lambda _, address: playout(play, address))
    monkeypatch.setattr(prediction_study, "score_predictors", lambda *_: made_up())


@pytest.mark.parametrize(
    ("name", "plots", "column", "cells"),
    [
        ("integrators", ("work-precision",), "integrator", [integrator_scores.DEFAULT, "RK4 × 1"]),
        ("playout", ("playout-1",), "rule", ["best constant", "best moving, 5 %", "ours"]),
        ("prediction", ("error-horizon", "cost-error"), "predictor", ["hold", "linear"]),
        ("cost", ("cost-1",), "predictor", ["hold"]),
        ("link", ("link-1",), "predictor", [name for name in PREDICTORS for _ in range(2)]),
    ],
)
def test_a_study_prints_its_tables_and_writes_page_pictures_and_json(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    plots: tuple[str, ...],
    column: str,
    cells: Sequence[str],
) -> None:
    little_work(monkeypatch)
    out, table = tmp_path / "new" / "folder", tmp_path / "tables.json"
    result = study(name, "--out", out, "--json", table)
    assert result.exit_code == 0, result.output
    assert cells[-1] in result.output
    assert result.output.endswith(f"report: {out / 'index.html'}\n")
    page = (out / "index.html").read_text(encoding="utf-8")
    for picture in (f"{plot}.svg" for plot in plots):
        assert picture in page
        assert (out / picture).exists()
    written: dict[str, Any] = json.loads(table.read_text(encoding="utf-8"))
    assert written == json.loads((out / "report.json").read_text(encoding="utf-8"))
    rows = written["chapters"][0]["tables"][0]["rows"]
    assert [row[column] for row in rows[: len(cells)]] == cells
    if name == "integrators":
        assert float(rows[0]["error"]) < 1e-14
    if name == "link":
        assert all(row["E (ms)"].startswith("auto: 4") for row in rows[1::2])
        curve, costs = (written["chapters"][at]["tables"][0]["rows"] for at in (1, 3))
        assert [row["E (ms)"] for row in curve] == ["0", "80"]
        assert [row["predictor"] for row in costs] == list(PREDICTORS)


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, work in ((sweep, "in_one_thread"), (playout_scores, "score_playout")):
        monkeypatch.setattr(module, work, lambda *_: pytest.fail("it went to work"))


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("name", ["integrators", "playout"])
@pytest.mark.parametrize("option", ["--out", "--json"])
def test_an_unwritable_path_is_one_line_before_the_work(
    name: str, option: str, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.touch()
    result = study(name, "--out", tmp_path, option, file / "below")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith(f"telepulse: {file / 'below'}: cannot be written")


@pytest.mark.usefixtures("no_work")
def test_without_the_extra_it_is_named_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = study("integrators", "--out", tmp_path)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert "pip install 'telepulse[report]'" in result.stderr


@pytest.mark.parametrize("name", SWEPT)
def test_every_swept_study_takes_a_scheduler(name: str, tmp_path: Path) -> None:
    result = study(name, "--out", tmp_path, "--scheduler", "nowhere")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("telepulse: nowhere: no Dask scheduler answers: ")
    assert result.stderr.count("\n") == 1
