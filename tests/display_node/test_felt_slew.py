"""What is felt changes no faster than the slew limit, whatever a peer asks."""

import random

import numpy as np
import pytest

from display_node.force_loop import build_force_loop
from display_node.safety import Safety
from telepulse.scene import find_scene, load_scene

ASKED_N = (0.0, 1e30, -1e30, 1.0, 0.3)
FOR_S = (0.005, 0.02, 0.05, 0.1, 0.3, 1.0)
# A microstep more or less, and what the loop makes good.
MARGIN = 1.02


# real_bench has a rotor that rings when its speed jumps, which no bound of the speed prevents.
@pytest.mark.parametrize("name", ["radial", "tmcl_bench"])
def test_forces_that_jump_are_felt_within_the_slew_limit_up_and_down(name: str) -> None:
    scene = load_scene(find_scene(name)).display
    tick_s = scene.tick_ns * 1e-9
    limit_n_per_s = scene.safety.slew_limit_n_per_s
    loop = build_force_loop(
        scene.controller,
        scene.actuator,
        scene.layer.layer(),
        scene.film,
        scene.safety.force_limit_n,
        tick_s,
        slew_limit_n_per_s=limit_n_per_s,
    )
    safety = Safety(scene.safety, scene.tick_ns)
    chance = random.Random(3)
    felt_n = []
    for _ in range(100):
        asked_n, ticks = chance.choice(ASKED_N), round(chance.choice(FOR_S) / tick_s)
        for _ in range(ticks):
            wanted_n = safety.bound([asked_n] * (loop.horizon + 1), alive=True)
            felt_n.append(loop.tick(wanted_n, loop.read_film()))
    slews_n_per_s = np.diff(felt_n) / tick_s
    assert 0.9 * limit_n_per_s < slews_n_per_s.max() <= MARGIN * limit_n_per_s
    assert 0.9 * limit_n_per_s < -slews_n_per_s.min() <= MARGIN * limit_n_per_s
