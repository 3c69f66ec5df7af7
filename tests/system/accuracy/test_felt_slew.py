"""Bound on the slew of the felt force, for any force that a peer sends."""

import numpy as np
import pytest

from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from tests.support.scene_loops import felt_under_jumps

# For one microstep, and the loop's correction.
MARGIN = 1.02


# Not real_bench: its rotor rings when its speed jumps, which no bound on the speed prevents.
@pytest.mark.parametrize("name", ["radial", "tmcl_bench"])
def test_forces_that_jump_are_felt_within_the_slew_limit_up_and_down(name: str) -> None:
    scene = load_scene(find_scene(name)).display
    limit_n_per_s = scene.safety.slew_limit_n_per_s
    slews_n_per_s = np.diff(felt_under_jumps(scene, jumps=100)) / (scene.tick_ns * 1e-9)
    assert 0.9 * limit_n_per_s < slews_n_per_s.max() <= MARGIN * limit_n_per_s
    assert 0.9 * limit_n_per_s < -slews_n_per_s.min() <= MARGIN * limit_n_per_s
