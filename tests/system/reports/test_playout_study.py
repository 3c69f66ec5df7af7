import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from telepulse.cli.main import app
from telepulse.reports.document import THEMES, Report
from telepulse.reports.studies import playout_scores
from telepulse.reports.studies.playout_links import GAUSSIAN, TCP
from telepulse.reports.studies.playout_report import TARGETS, compare_targets, report_playout
from telepulse.reports.studies.playout_scores import (
    OURS,
    RULES,
    PlayoutEffort,
    PlayoutScores,
    RuleOnLink,
    score_playout,
    score_rule,
)

LITTLE = PlayoutEffort(seconds=20, scan=3, bisections=3, links=(GAUSSIAN, TCP), curves=(TCP,))


@pytest.fixture(scope="module")
def scores() -> PlayoutScores:
    return score_playout(LITTLE)


@pytest.fixture(scope="module")
def report(scores: PlayoutScores) -> Report:
    return report_playout(scores, LITTLE)


def test_every_rule_and_both_optima_have_a_row_on_every_link(report: Report) -> None:
    steady, unsteady, _ = report.chapters[0].tables
    assert steady.columns == ("rule", GAUSSIAN)
    assert unsteady.columns == ("rule", TCP)
    for table in (steady, unsteady):
        assert [row[0] for row in table.rows[2:]] == list(RULES)
        constant, moving = (cells for _, cells in table.rows[:2])
        assert moving.endswith("(1.00)")
        assert float(constant.split()[0]) > float(moving.split()[0])
    free, _, warped, _ = report.chapters[1].tables
    assert [row[0] for row in free.rows] == [row[0] for row in warped.rows] == list(RULES)


def test_a_tuned_rule_is_within_the_share_and_no_better_than_the_bound(
    scores: PlayoutScores,
) -> None:
    for link, rules in scores.rules.items():
        for score in rules.values():
            assert not score.reached or score.tuned.late <= LITTLE.late
            assert score.tuned.delay_ms >= scores.links[link].moving_ms
            assert score.tuned in score.tried
            within = [one.delay_ms for one in score.tried if one.late <= LITTLE.late]
            assert score.tuned.delay_ms == min(within)
    assert scores.rules[GAUSSIAN][OURS].tuned.late > 0.5 * LITTLE.late


def test_a_share_that_no_setting_reaches_is_reported(scores: PlayoutScores, report: Report) -> None:
    strict = PlayoutEffort(seconds=20, scan=2, bisections=1, links=(TCP,), late=0.0)
    score = score_rule(RuleOnLink("Moon percentile", TCP), strict)
    assert not score.reached
    missed = PlayoutScores({TCP: scores.links[TCP]}, {TCP: dict.fromkeys(RULES, score)})
    cells = [row[1] for row in report_playout(missed, strict).chapters[0].tables[0].rows[2:]]
    assert all(cell.endswith(f" at {score.tuned.late:.1%}") for cell in cells)


def test_the_verdict_is_counted_from_the_ratios(scores: PlayoutScores, report: Report) -> None:
    judged = compare_targets(scores)
    assert [(link, optimum) for link, optimum, *_ in judged] == [
        (link, optimum) for link, optimum, _ in TARGETS if link in LITTLE.links
    ]
    reached = sum(ratio <= bar for _, _, bar, ratio in judged)
    shown = [row[3] for row in report.chapters[0].tables[-1].rows]
    assert shown.count("met") == reached
    sentence = report.chapters[0].paragraphs[0]
    assert sentence.startswith(
        f"All {reached} targets"
        if reached == len(judged)
        else f"{reached} of {len(judged)} targets"
    )


def test_the_command_prints_its_tables_and_writes_page_pictures_and_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scores: PlayoutScores
) -> None:
    monkeypatch.setattr(playout_scores, "score_playout", lambda *_: scores)
    out, table = tmp_path / "new" / "folder", tmp_path / "tables.json"
    result = CliRunner().invoke(app, ["study", "playout", "--out", str(out), "--json", str(table)])
    assert result.exit_code == 0, result.output
    assert "NetEQ-like" in result.output
    assert result.output.endswith(f"report: {out / 'index.html'}\n")
    for theme in THEMES:
        assert (out / f"playout-1-{theme.name}.png").read_bytes().startswith(b"\x89PNG")
    written = json.loads(table.read_text(encoding="utf-8"))
    assert written["chapters"][0]["tables"][0]["rows"][2]["rule"] == OURS


@pytest.mark.parametrize("option", ["--out", "--json"])
def test_what_cannot_be_written_is_one_line_before_the_work(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(playout_scores, "score_playout", lambda *_: pytest.fail("it worked"))
    file = tmp_path / "file"
    file.touch()
    result = CliRunner().invoke(
        app, ["study", "playout", "--out", str(tmp_path), option, str(file / "below")]
    )
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith(f"telepulse: {file / 'below'}: cannot be written")
    assert result.stderr.count("\n") == 1
