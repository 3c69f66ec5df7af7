"""Felt force where a peer's forces jump beyond all limits, in virtual time."""

import numpy as np

from benchmarks.measure import show
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from tests.support.scene_loops import REQUESTED_N, felt_under_jumps

SCENES = ("radial", "tmcl_bench", "real_bench")
JUMPS = 200


def main() -> None:
    """Print the table."""
    rows = []
    for name in SCENES:
        scene = load_scene(find_scene(name)).display
        felt_n = felt_under_jumps(scene, JUMPS)
        slews_n_per_s = np.diff(felt_n) / (scene.tick_ns * 1e-9)
        up, down = slews_n_per_s.max(), -slews_n_per_s.min()
        rows.append((name, f"{felt_n.max():.3f}", f"{up:.1f}", f"{down:.1f}"))
    show(
        f"{JUMPS} jumps to {', '.join(f'{force:g}' for force in REQUESTED_N)} N;"
        " 2.5 N and 50 N/s are allowed",
        ("scene", "most N", "up N/s", "down N/s"),
        rows,
    )
