import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.golden.__main__ import paper_numbers, read_paper_numbers
from tests.support.nodes import ROOT, read_json, run

MODULE = "telepulse"
PLOTS = {
    "calibration",
    "simulated-strain",
    "force-tracking",
    "strain-tracking",
    "readings",
    "pulse",
    "spectrum",
    "presets",
}


@dataclass(frozen=True)
class Written:
    output: str
    folder: Path
    table: dict[str, Any]

    def rows(self, title: str) -> dict[str, dict[str, str]]:
        """A table's rows by their first cell."""
        for chapter in self.table["chapters"]:
            for table in chapter["tables"]:
                if table["title"] == title:
                    return {next(iter(row.values())): row for row in table["rows"]}
        raise LookupError(title)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("paper")
    out, json = folder / "new" / "report", folder / "tables.json"
    result = run(MODULE, "paper", "--out", str(out), "--json", str(json), timeout_s=110)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return Written(result.stdout, out, read_json(json))


def test_every_number_is_the_same_as_before(written: Written) -> None:
    assert paper_numbers(written.table) == read_paper_numbers()


def test_it_prints_its_tables_and_where_the_report_is(written: Written) -> None:
    assert written.output.endswith(f"report: {written.folder / 'index.html'}\n")
    for words in ("Paper and ours", "why they differ", "99.71 %", "0.020863 N"):
        assert words in written.output


def test_every_figure_is_there_in_both_themes(written: Written) -> None:
    page = (written.folder / "index.html").read_text("utf-8")
    shown = set(re.findall(r'(?:src|srcset)="([^"]+)"', page))
    assert {f"{name}-{theme}.png" for name in PLOTS for theme in ("light", "dark")} <= shown
    for name in shown:
        assert (written.folder / name).read_bytes().startswith(b"\x89PNG"), name


def test_the_page_states_that_no_unit_gives_all_three(written: Written) -> None:
    page = (written.folder / "index.html").read_text("utf-8")
    assert "No unit gives all three figures." in page
    assert not re.search(r"\b(nan|inf|None)\b", page)


def test_each_figure_of_the_paper_has_ours_and_why(written: Written) -> None:
    rows = written.rows("Paper and ours")
    assert len(rows) == 11
    for words in ("Fig. 4", "Figs 13–14", "Fig. 15", "Fig. 16", "Figs 17–18", "Figs 19–20"):
        assert any(name.startswith(words) for name in rows)
    assert all(row["paper"] and row["ours"] and row["why they differ"] for row in rows.values())
    simulated = rows["Figs 13–14, strain RMSE of the simulation"]
    assert simulated["paper"] == "9.4249e-9"
    # 9.4249e-9 at 0.888 N.
    assert simulated["ours"].startswith("3.18")
    assert "0.888 N" in simulated["why they differ"]
    measured = rows["Figs 19–20, strain RMSE of the experiment"]["why they differ"]
    assert "12.106 mN" in measured
    assert "20.863 mN" in measured


def test_which_reading_can_have_given_which_figure(written: Written) -> None:
    title = (
        "The pulse's height at which a unit gives a printed figure, and whether that is possible"
    )
    rows = written.rows(title)
    for name, row in rows.items():
        cells = list(row.values())[1:]
        if name == "mV by eq 21":
            assert [cell.split("; ")[1].split(",")[0] for cell in cells] == [
                "possible",
                "no",
                "possible",
            ]
        else:
            assert all(cell.endswith("; no, does not follow") for cell in cells)


def test_a_folder_that_cannot_be_written_is_refused_first(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = run(MODULE, "paper", "--out", str(tmp_path / "file" / "report"))
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "cannot be written" in result.stderr
    assert result.stdout == ""


def test_a_json_file_that_cannot_be_written_is_refused_first(tmp_path: Path) -> None:
    missing = tmp_path / "nowhere" / "out.json"
    result = run(MODULE, "paper", "--out", str(tmp_path / "report"), "--json", str(missing))
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert str(missing) in result.stderr
    assert result.stdout == ""


def test_without_the_extra_it_names_it(tmp_path: Path) -> None:
    program = (
        "import sys; sys.modules['matplotlib'] = None; import telepulse.cli.main as c; c.main()"
    )
    result = subprocess.run(
        [sys.executable, "-c", program, "paper", "--out", str(tmp_path / "report")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "pip install 'telepulse[report]'" in result.stderr
