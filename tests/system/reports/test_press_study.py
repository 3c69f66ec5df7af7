"""The bars of the press over one link, and that its report says when one is missed."""

from dataclasses import replace

import pytest

from display_node.press.finger_press import PressLimits
from telepulse.reports.studies.press_report import report_press
from telepulse.reports.studies.press_runs import EASED_S, MOST_GAIN, FollowScore, follow
from telepulse.reports.studies.press_scores import (
    REGULAR_PULSES,
    VARIANTS,
    PressEffort,
    PressScores,
    score_press,
)
from telepulse.simulation.press_loop import PressSetting, link_of

# The scores take half a minute of two cores, and longer on busy ones.
pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]
HIGH = "160/100 mmHg, regular"
LITTLE = PressEffort(
    (0.1,),
    stiffnesses=(0.3, 3.0),
    seeds=(1,),
    seconds=40.0,
    variants=VARIANTS[::3],
    pulses={HIGH: REGULAR_PULSES[HIGH]},
)


@pytest.fixture(scope="module")
def scores() -> PressScores:
    return score_press(LITTLE)


def verdicts(scores: PressScores) -> dict[str, list[str]]:
    tables = [
        table for chapter in report_press(scores, LITTLE).chapters for table in chapter.tables
    ]
    assert len(tables) == 8
    return {table.title: [row[-1] for row in table.rows] for table in tables}


def test_every_bar_is_met(scores: PressScores) -> None:
    found = verdicts(scores)
    assert all("missed" not in verdict for table in found.values() for verdict in table)
    force_n, slew = scores.finger
    assert force_n <= PressLimits().force_n
    assert slew == pytest.approx(PressLimits().slew_n_per_s, rel=1e-3)
    ((score,),) = scores.follow.values()
    account = score.account
    assert account.sent == sum((account.applied, account.superseded, account.lost))  # type: ignore[arg-type]
    assert (account.sent or 0) > 1900
    assert all(max(gains) < MOST_GAIN for gains in scores.gains.values())
    assert all(0.2 < eased_s <= EASED_S for eased_s in scores.eased_s.values())


def test_a_missed_bar_is_named(scores: PressScores) -> None:
    def worse(score: FollowScore) -> FollowScore:
        return score._replace(late=(0.06,), heights=(-0.11,))

    bad = replace(
        scores,
        follow={trip: [worse(each) for each in runs] for trip, runs in scores.follow.items()},
        tcp={},
        wrists={key: worse(run) for key, run in scores.wrists.items()},
        stiff={(0.0, 1.0, 1.0): 0.06},
        finger=(3.01, 1.0),
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
        "missed, missed",
        "missed",
        "missed",
        "missed",
        "met",
        "missed",
        "missed",
        "missed",
    ]
    assert report.findings[-1].startswith("Missed: the hold-down on the study's own wrist; the")
    assert "the finger's limits" in report.findings[-1]


def test_a_wrist_of_high_pressure_is_felt_over_a_slow_link_without_visits_too() -> None:
    """With a curve without a law, -30 % to +14 % at forces never visited, and a gain of 0.18."""
    pulse = REGULAR_PULSES[HIGH]
    score, *_ = follow(PressSetting(link_of(1.0), pulse=pulse), 48.0)
    assert score.gain < MOST_GAIN
    assert max(map(abs, score.heights)) < 0.06
