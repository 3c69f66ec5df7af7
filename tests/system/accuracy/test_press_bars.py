"""The bars of the press over one link, in virtual time; `make bench ARGS=press` has all of them."""

import pytest

from display_node.press.finger_press import PressLimits
from sensing_node.press.probe import ProbeLimits
from tests.support.press_loop import ArterialPulse, PressSetting, link_of
from tests.support.press_runs import (
    FOLLOW_ERROR,
    HEIGHT_ERROR,
    MOST_GAIN,
    FollowScore,
    be_hostile,
    be_hostile_to_the_finger,
    follow,
    open_gain,
    swing,
)

pytestmark = pytest.mark.timeout(600)
HIGH = ArterialPulse(160.0, 100.0)


def check(score: FollowScore) -> None:
    assert max(score.late) <= FOLLOW_ERROR
    assert max(map(abs, score.heights)) <= HEIGHT_ERROR
    assert score.gain < MOST_GAIN


@pytest.mark.parametrize(
    "setting",
    [
        PressSetting(link_of(0.1)),
        PressSetting(link_of(0.1, "tcp"), connections=16),
        PressSetting(link_of(0.1), pulse=HIGH),
    ],
    ids=["own wrist", "over TCP", "another wrist"],
)
def test_steps_are_followed_and_felt_with_their_height(setting: PressSetting) -> None:
    score = follow(setting, 40.0)
    check(score)
    account = score.account
    assert account.sent == sum((account.applied, account.superseded, account.lost))
    assert (account.sent or 0) > 1900


def test_a_wrist_of_high_pressure_is_felt_over_a_slow_link_without_visits_too() -> None:
    """With a curve without a law, -30 % to +14 % at forces never visited, and a gain of 0.18."""
    score = follow(PressSetting(link_of(1.0), pulse=HIGH), 48.0)
    assert score.gain < MOST_GAIN
    assert max(map(abs, score.heights)) < 0.06


@pytest.mark.parametrize(("tissue", "finger"), [(0.3, 3.0), (3.0, 0.3)])
def test_nothing_swings_on_after_a_step(tissue: float, finger: float) -> None:
    assert swing(PressSetting(link_of(0.1), tissue, finger, pulse_share=finger)).decays
    assert max(open_gain(PressSetting(link_of(0.1), pulse_share=finger))) < MOST_GAIN


def test_neither_end_exceeds_its_limits_with_a_hostile_peer() -> None:
    limits, hand = ProbeLimits(), PressLimits()
    force_n, slew = be_hostile(3.0)
    assert force_n <= limits.force_limit_n
    assert slew <= limits.slew_limit_n_per_s
    finger_n, finger_slew = be_hostile_to_the_finger()
    assert finger_n <= hand.force_n
    assert finger_slew == pytest.approx(hand.slew_n_per_s, rel=1e-3)
