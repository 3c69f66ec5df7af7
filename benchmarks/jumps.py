"""Felt force under a peer whose forces jump beyond all limits, in virtual time."""

import random

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import show
from display_node.control.safety import Safety
from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene

SCENES = ("radial", "tmcl_bench", "real_bench")
ASKED_N = (0.0, 1e30, -1e30, 1.0, 0.3)
FOR_S = (0.005, 0.02, 0.05, 0.1, 0.3, 1.0)
JUMPS = 200


def main() -> None:
    """Print the table."""
    rows = []
    for name in SCENES:
        scene = load_scene(find_scene(name)).display
        felt_n = felt(scene, JUMPS)
        slews_n_per_s = np.diff(felt_n) / (scene.tick_ns * 1e-9)
        up, down = slews_n_per_s.max(), -slews_n_per_s.min()
        rows.append((name, f"{felt_n.max():.3f}", f"{up:.1f}", f"{down:.1f}"))
    show(
        f"{JUMPS} jumps to {', '.join(f'{force:g}' for force in ASKED_N)} N;"
        " 2.5 N and 50 N/s are allowed",
        ("scene", "most N", "up N/s", "down N/s"),
        rows,
    )


def felt(scene: DisplayScene, jumps: int) -> NDArray[np.float64]:
    """The force in N after each tick of the loop of a scene, behind its safety."""
    loop = scene.force_loop()
    safety = Safety(scene.safety, scene.tick_ns)
    chance = random.Random(3)
    felt_n = []
    for _ in range(jumps):
        asked_n, for_s = chance.choice(ASKED_N), chance.choice(FOR_S)
        for _ in range(round(for_s * 1e9 / scene.tick_ns)):
            wanted_n = safety.bound([asked_n] * (loop.horizon + 1), alive=True)
            felt_n.append(loop.tick(wanted_n, loop.read_film()))
    return np.array(felt_n)
