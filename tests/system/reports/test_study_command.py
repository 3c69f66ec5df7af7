import json
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from telepulse.cli.main import app
from telepulse.reports.document import THEMES
from telepulse.reports.studies import sweep
from telepulse.reports.studies.integrator_scores import DEFAULT, IntegratorEffort

LITTLE = IntegratorEffort(seconds=0.1, rounds=1, substeps=(1,), solvers=(), rotor_seconds=0.02)


def test_the_command_prints_its_tables_and_writes_page_pictures_and_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = sweep.in_one_thread
    monkeypatch.setattr(sweep, "in_one_thread", lambda work, _: alone(work, LITTLE))
    out, table = tmp_path / "new" / "folder", tmp_path / "tables.json"
    result = CliRunner().invoke(
        app, ["study", "integrators", "--out", str(out), "--json", str(table)]
    )
    assert result.exit_code == 0, result.output
    assert DEFAULT in result.output
    assert result.output.endswith(f"report: {out / 'index.html'}\n")
    page = (out / "index.html").read_text(encoding="utf-8")
    for theme in THEMES:
        picture = f"work-precision-{theme.name}.png"
        assert picture in page
        assert (out / picture).read_bytes().startswith(b"\x89PNG")
    written = json.loads(table.read_text(encoding="utf-8"))
    assert written == json.loads((out / "report.json").read_text(encoding="utf-8"))
    rows = written["chapters"][0]["tables"][0]["rows"]
    assert rows[0]["integrator"] == DEFAULT
    assert float(rows[0]["error"]) < 1e-14


@pytest.mark.parametrize("option", ["--out", "--json"])
def test_what_cannot_be_written_is_one_line_before_the_work(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep, "in_one_thread", lambda *_: pytest.fail("it went to work"))
    file = tmp_path / "file"
    file.touch()
    result = CliRunner().invoke(
        app, ["study", "integrators", "--out", str(tmp_path), option, str(file / "below")]
    )
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith(f"telepulse: {file / 'below'}: cannot be written")


def test_without_the_extra_it_is_named_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(sweep, "in_one_thread", lambda *_: pytest.fail("it went to work"))
    result = CliRunner().invoke(app, ["study", "integrators", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert "pip install 'telepulse[report]'" in result.stderr
