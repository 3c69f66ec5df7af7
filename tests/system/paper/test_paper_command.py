import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.golden.__main__ import paper_numbers, read
from tests.support.nodes import read_json, run

PLOTS = {
    *("calibration", "simulated-strain", "force-tracking", "strain-tracking", "readings"),
    *("pulse", "spectrum", "presets", "real-bench", "stability"),
}


@dataclass(frozen=True)
class Written:
    output: str
    folder: Path
    report: dict[str, Any]

    def table(self, title: str) -> dict[str, Any]:
        tables = [table for chapter in self.report["chapters"] for table in chapter["tables"]]
        (found,) = [table for table in tables if table["title"] == title]
        return dict(found)

    def rows(self, title: str) -> dict[str, dict[str, str]]:
        """A table's rows by their first cell."""
        return {next(iter(row.values())): row for row in self.table(title)["rows"]}


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
    for words in ("Paper and ours", "why they differ", "99.71 %", "0.020863 N"):
        assert words in written.output


def test_every_figure_is_there_in_both_themes(written: Written) -> None:
    page = (written.folder / "index.html").read_text("utf-8")
    shown = set(re.findall(r'(?:src|srcset)="([^"]+)"', page))
    assert {f"{name}-{theme}.png" for name in PLOTS for theme in ("light", "dark")} <= shown
    for name in shown:
        assert (written.folder / name).read_bytes().startswith(b"\x89PNG"), name


def test_the_page_states_what_is_impossible_and_why(written: Written) -> None:
    page = (written.folder / "index.html").read_text("utf-8")
    assert "No unit gives all three." in page
    assert not re.search(r"\b(nan|inf|None)\b", page)
    controllers = written.table("Force RMSE by what the controller models")
    assert controllers["rows"][0]["real bench"] == "refused"
    assert controllers["note"].startswith("Refused by the display: the force loop is not stable")


def test_the_page_has_no_numbers_as_programs_print_them(written: Written) -> None:
    page = (written.folder / "index.html").read_text("utf-8")
    text = re.sub(r"<code>.*?</code>|<[^>]*>", " ", page[page.index("<body>") :])
    assert not re.findall(r"(?<![\w.])[\d.]+e[+-]?\d+\b", text)
    assert not re.findall(r"\d%|\d (?:N|mN|ms|Hz|%|µm)\b", text)
    assert "9.4249×10⁻⁹" in text
    assert "1\u00a0−\u00a06.6×10⁻⁴" in text


def test_the_findings_compare_like_with_like(written: Written) -> None:
    findings = written.report["findings"]
    assert len(findings) <= 5
    assert "a force of 12.1 mN, 0.58 times the printed force error" in findings[1]
    assert findings[2].endswith("follow the pulse only with mV by eq 21.")


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


def test_which_unit_can_have_given_which_figure(written: Written) -> None:
    title = (
        "The pulse's height at which a unit gives a printed figure, and whether that is possible"
    )
    rows = written.rows(title)
    heights = {name: list(row.values())[1:] for name, row in rows.items()}
    film_mv = [cell.split("; ")[1].split(",")[0] for cell in heights.pop("mV by eq 21")]
    assert film_mv == ["possible", "no", "possible"]
    for cells in heights.values():
        assert all(cell.endswith("; no, does not follow") for cell in cells)
