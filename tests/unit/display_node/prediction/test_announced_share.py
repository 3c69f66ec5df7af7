"""The share of the announced path: learnt by the moment of the beat, and all in a pause."""

import numpy as np
import pytest

from display_node.prediction.announced import AnnouncedShare
from display_node.prediction.expert import FURTHEST, HORIZONS

NO_PAUSE = (0.0, 0.0)
BEFORE, RISING, PASSED = -20.0, 10.0, 60.0


def learn(
    share: AnnouncedShare,
    since_arrival: float,
    right: bool,
    steps: int = 200,
    unprecedented: bool = False,
) -> None:
    """Learn from a constant signal, of which one path is right and the other 1 too high."""
    difference = np.full(HORIZONS, -1.0 if right else 1.0)
    path = np.full(HORIZONS, 1.0 if right else 0.0)
    for _ in range(steps):
        share.of(difference, since_arrival, NO_PAUSE)
        share.learn(np.zeros(HORIZONS + 1), path, difference, unprecedented, artefact=False)


def test_the_share_of_each_moment_is_learnt_on_its_own() -> None:
    share, difference = AnnouncedShare(), np.ones(HORIZONS)
    learn(share, RISING, right=False)
    learn(share, BEFORE, right=True)
    assert share.of(difference, BEFORE, NO_PAUSE) == pytest.approx(np.ones(HORIZONS), abs=0.05)
    assert share.of(difference, RISING, NO_PAUSE).max() < 0.05
    assert share.of(difference, PASSED, NO_PAUSE).max() == 0


def test_in_a_pause_a_large_difference_is_played_and_a_small_one_is_not() -> None:
    """The horizons are 2 to 50 steps ahead; those from 10 to 31 lie in the pause."""
    share = AnnouncedShare().of(np.full(HORIZONS, 5.0), PASSED, (10.0, 31.0))
    ahead = np.arange(2, FURTHEST + 1, 2)
    inside = (ahead >= 10) & (ahead <= 31)
    assert (share[inside] > 0.95).all()
    assert (share[~inside] == 0).all()
    assert AnnouncedShare().of(np.full(HORIZONS, 0.1), PASSED, (10.0, 31.0)).max() < 0.01


@pytest.mark.parametrize("pause", [(30.0, 20.0), (52.0, 80.0), (-40.0, 1.0), (-900.0, -3.0)])
def test_a_pause_beyond_all_horizons_changes_nothing(pause: tuple[float, float]) -> None:
    assert not AnnouncedShare().of(np.full(HORIZONS, 5.0), PASSED, pause).any()


def test_nothing_is_learnt_from_a_pause_without_precedent() -> None:
    share = AnnouncedShare()
    learn(share, PASSED, right=True, unprecedented=True)
    assert not share.of(np.ones(HORIZONS), PASSED, NO_PAUSE).any()
