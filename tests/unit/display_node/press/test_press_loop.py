"""The loop of the press over a link: cuts, and set-points of others."""

import numpy as np
import pytest

from sensing_node.press.probe import ProbeLimits
from telepulse.simulation.link_model import MessageLink
from telepulse.simulation.link_scene import LinkScene
from tests.support.press_loop import (
    PressLoop,
    PressSetting,
    link_of,
)

LIMITS = ProbeLimits()
EVERY = 5


def test_a_cut_eases_off_within_half_a_second_and_the_press_returns_by_a_ramp() -> None:
    link = LinkScene.model_validate(
        {"delay": "10 ms", "cut": {"from": "4 s", "for": "3 s"}, "loss": "1 %"}
    )
    loop = PressLoop(PressSetting(link), lambda time_s: 1.2)
    trace = loop.run(10.0)
    assert trace.hold_down_n[3900] == pytest.approx(1.2, rel=0.05)
    assert trace.hold_down_n[4520:6400].max() < LIMITS.resting_n + 0.05
    assert trace.hold_down_n[6900] == 0.0
    assert trace.hold_down_n[-1] == pytest.approx(1.2, rel=0.05)
    returned = trace.hold_down_n[7000::EVERY]
    assert np.diff(returned).max() / (EVERY * 1e-3) < 0.3 * LIMITS.slew_limit_n_per_s


@pytest.mark.parametrize("way", ["set-points", "samples"])
def test_a_cut_of_one_direction_eases_off_as_well(way: str) -> None:
    """Without set-points the wrist eases off; without samples the finger sends none."""
    loop = PressLoop(PressSetting(link_of(0.02, loss=0.0)), lambda time_s: 1.2)
    cut = LinkScene.model_validate({"delay": "10 ms", "cut": {"from": "3 s", "for": "4 s"}})
    if way == "samples":
        loop._down = MessageLink(cut, 5)
    else:
        loop._up = [MessageLink(cut, 5)]
    trace = loop.run(9.0)
    assert trace.hold_down_n[2900] == pytest.approx(1.2, rel=0.05)
    # The finger is blind after 0.3 s and the played delay; from then on, the wrist as after a cut.
    eased_ms = 3_600 if way == "set-points" else 3_600 + 400
    assert trace.hold_down_n[eased_ms:].max() == trace.hold_down_n[7_000:].max()
    assert trace.hold_down_n[eased_ms:5_000].max() < LIMITS.resting_n + 0.05
    assert trace.hold_down_n[6_900] == 0.0
    assert trace.hold_down_n[-1] == pytest.approx(1.2, rel=0.05)
    counts = loop.press.sender.counts()
    assert counts.sent == (counts.applied or 0) + (counts.superseded or 0) + (counts.lost or 0)
