import pytest

from telepulse.document import Report, percent
from telepulse.reports.studies.playout_links import DENSE, GAUSSIAN, SHORT_BURSTS, TCP
from telepulse.reports.studies.playout_report import UNCOVERED, report_playout
from telepulse.reports.studies.playout_scores import (
    MOVING,
    OURS,
    RULES,
    TARGETS,
    PlayoutEffort,
    PlayoutScores,
    RuleOnLink,
    compare_targets,
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
            assert not score.reached or score.tuned.late <= LITTLE.permitted_late
            assert score.tuned.delay_ms >= scores.links[link].optima_ms[MOVING]
            assert score.tuned in score.tried
            within = [one.delay_ms for one in score.tried if one.late <= LITTLE.permitted_late]
            assert score.tuned.delay_ms == min(within)
    assert scores.rules[GAUSSIAN][OURS].tuned.late > 0.5 * LITTLE.permitted_late


def test_a_share_that_no_setting_reaches_is_reported(scores: PlayoutScores, report: Report) -> None:
    strict = PlayoutEffort(seconds=20, scan=2, bisections=1, links=(TCP,), permitted_late=0.0)
    score = score_rule(RuleOnLink("Moon percentile", TCP), strict)
    assert not score.reached
    missed = PlayoutScores({TCP: scores.links[TCP]}, {TCP: dict.fromkeys(RULES, score)})
    cells = [row[1] for row in report_playout(missed, strict).chapters[0].tables[0].rows[2:]]
    assert all(cell.endswith(f" at {percent(score.tuned.late)}") for cell in cells)


def test_the_verdict_is_counted_from_the_ratios(scores: PlayoutScores, report: Report) -> None:
    judged = compare_targets(scores)
    assert [(link, optimum) for link, optimum, *_ in judged] == [
        (link, optimum) for link, optimum, _ in TARGETS if link in LITTLE.links
    ]
    met = sum(ratio <= target for _, _, target, ratio in judged)
    assert [row[3] for row in report.chapters[0].tables[-1].rows].count("met") == met
    count = f"All {met}" if met == len(judged) else f"{met} of {len(judged)}"
    assert report.chapters[0].findings[0].startswith(f"{count} targets")


def test_the_findings_name_the_links_without_a_target(scores: PlayoutScores) -> None:
    assert UNCOVERED == (SHORT_BURSTS, DENSE)
    dense = PlayoutScores(
        {**scores.links, DENSE: scores.links[TCP]}, {**scores.rules, DENSE: scores.rules[TCP]}
    )
    findings = report_playout(dense, LITTLE).findings
    ratio = dense.rules[DENSE][OURS].tuned.delay_ms / dense.links[DENSE].optima_ms[MOVING]
    assert any(each.startswith(f"No target covers {DENSE}: ours {ratio:.2f} ") for each in findings)
    assert len(findings) <= 5


def test_the_published_rules_have_their_references(report: Report) -> None:
    references = " ".join(report.chapters[-1].paragraphs)
    for name in ("Ramjee", "Moon", "NetEQ"):
        assert name in references
        assert name in report.chapters[0].paragraphs[-1]
