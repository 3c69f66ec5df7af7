"""The runner of the benchmarks: verdicts, and tables written into a page."""

from pathlib import Path

import pytest

from benchmarks.benchmark import Benchmark, Table, write_tables
from benchmarks.criteria import CRITERIA, Criterion, share

PAGE = "before\n<!-- bench drawn -->\nold\n<!-- end drawn -->\nafter\n"


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> Benchmark:
    criteria = (share("error", most=0.05), Criterion("speed", least=2.0))
    monkeypatch.setitem(CRITERIA, "drawn", criteria)
    return Benchmark("drawn")


@pytest.mark.parametrize(
    ("error", "speed", "verdicts"),
    [
        (0.05, 2.0, ["holds", "holds"]),
        (0.051, 3.0, ["falls short", "holds"]),
        (float("nan"), 1.9, ["falls short", "falls short"]),
    ],
)
def test_a_figure_is_judged_by_its_bound(
    judged: Benchmark, error: float, speed: float, verdicts: list[str]
) -> None:
    judged.judge("error", error)
    judged.judge("speed", speed)
    assert judged.close() == (verdicts == ["holds", "holds"])
    assert [row[-1] for row in judged.tables[-1].rows] == verdicts
    assert judged.tables[-1].rows[0][1] == "at most 5 %"


def test_a_criterion_without_a_figure_is_not_met_in_silence(judged: Benchmark) -> None:
    judged.judge("speed", 3.0)
    judged.close()
    assert judged.tables[-1].rows[0][-1] == "not measured"
    assert judged.tables[-1].title == "1 of 2 criteria hold"


def test_tables_replace_those_between_the_marks(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text(PAGE, encoding="utf-8")
    table = Table("Errors", ("pulse", "a|b"), [("regular", "1")], "In mN.")
    for _ in range(2):
        write_tables(path, "drawn", [table])
    text = path.read_text(encoding="utf-8")
    assert text.startswith("before\n<!-- bench drawn -->\n\n**Errors**\n")
    assert "| pulse | a\\|b |\n| --- | --- |\n| regular | 1 |\n\nIn mN.\n" in text
    assert text.endswith("<!-- end drawn -->\nafter\n")
    assert "old" not in text
    assert text.count("regular") == 1
