"""The bars of the press over one link, and that its report says when one is missed."""

from dataclasses import replace

import pytest

from telepulse.reports.studies.press_report import report_press
from telepulse.reports.studies.press_scores import (
    EASED_S,
    MOST_GAIN,
    VARIANTS,
    FollowScore,
    PressEffort,
    PressScores,
    score_press,
)

pytestmark = pytest.mark.system
LITTLE = PressEffort(
    (0.1,), stiffnesses=(0.3, 3.0), seeds=(1,), seconds=44.0, variants=VARIANTS[::3]
)


@pytest.fixture(scope="module")
def scores() -> PressScores:
    return score_press(LITTLE)


def verdicts(scores: PressScores) -> list[str]:
    tables = [
        table for chapter in report_press(scores, LITTLE).chapters for table in chapter.tables
    ]
    assert len(tables) == 6
    return [row[-1] for table in tables for row in table.rows]


def test_every_bar_is_met(scores: PressScores) -> None:
    assert all("missed" not in verdict for verdict in verdicts(scores))
    ((score,),) = scores.follow.values()
    account = score.account
    assert account.sent == sum((account.applied, account.superseded, account.lost))  # type: ignore[arg-type]
    assert (account.sent or 0) > 2000
    assert all(max(gains) < MOST_GAIN for gains in scores.gains.values())
    assert all(0.2 < eased_s <= EASED_S for eased_s in scores.eased_s.values())


def test_a_missed_bar_is_named(scores: PressScores) -> None:
    def worse(score: FollowScore) -> FollowScore:
        return score._replace(late=(0.06,), heights=(-0.11,))

    bad = replace(
        scores,
        follow={trip: [worse(each) for each in runs] for trip, runs in scores.follow.items()},
        tcp={},
        swing={
            key: swing._replace(rms_n=(0.01, 0.02, 0.01, 0.0))
            for key, swing in scores.swing.items()
        },
        gains={1.0: (0.2, 0.0)},
        hostile={1.0: (3.01, 1.0)},
        eased_s={(1.0, 0.0): 0.51},
    )
    report = report_press(bad, LITTLE)
    tables = [table for chapter in report.chapters for table in chapter.tables]
    assert [row[-1] for table in tables for row in table.rows] == [
        "missed, missed",
        "missed",
        "missed",
        "met",
        "missed",
        "missed",
    ]
