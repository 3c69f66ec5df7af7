import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.golden.__main__ import paper_numbers, read
from tests.support.nodes import read_json, run

PLOTS = {
    *("calibration", "simulated-strain", "force-tracking", "strain-tracking", "readings"),
    *("pulse", "spectrum", "real-bench", "stability"),
}


@dataclass(frozen=True)
class Written:
    output: str
    folder: Path
    report: dict[str, Any]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("paper")
    out, json = folder / "new" / "report", folder / "tables.json"
    result = run("telepulse", "paper", "--out", str(out), "--json", str(json), timeout_s=110)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return Written(result.stdout, out, read_json(json))


def test_every_number_is_the_same_as_before(written: Written) -> None:
    assert paper_numbers(written.report) == read("paper")


def test_it_prints_its_tables_and_where_the_report_is(written: Written) -> None:
    assert written.output.endswith(f"report: {written.folder / 'index.html'}\n")
    for words in ("99.71 %", "0.020863 N", "Not reproducible"):
        assert words in written.output


def test_the_page_opens_with_what_the_paper_prints_beside_ours(written: Written) -> None:
    (opening,) = written.report["chapters"][0]["tables"]
    rows = {row["figure"]: (row["paper"], row["ours"]) for row in opening["rows"]}
    assert rows["strain RMSE, simulation (Figs 13–14)"] == ("9.4249e-9", "3.1846e-9 at 0.3 N")
    assert rows["force RMSE, experiment (Figs 17–18)"][0] == "0.020863 N"
    assert rows["strain RMSE, experiment (Figs 19–20)"][0] == "5.7802e-8"
    assert rows["pulse (Fig. 15)"] == ("75 beats/min", "75 beats/min")
    shares = [cells for name, cells in rows.items() if name.startswith("energy below")]
    assert [paper for paper, _ in shares] == ["99.7 %", "89.4 %", "57.4 %", "12.4 %", "4.8 %"]
    for cells in shares:
        paper, ours = (float(cell.removesuffix(" %")) for cell in cells)
        assert ours == pytest.approx(paper, abs=0.1)


def test_the_page_shows_every_plot_and_no_figure_is_missing(written: Written) -> None:
    page = (written.folder / "index.html").read_text("utf-8")
    assert set(re.findall(r'src="([^"]+)"', page)) == {f"{name}.svg" for name in PLOTS}
    for name in PLOTS:
        assert (written.folder / f"{name}.svg").stat().st_size > 5_000
    assert not re.search(r"\b(nan|inf|None)\b|\{[\{%]", page[page.index("<body>") :])
