"""Felt force and slew where a peer's forces jump beyond all limits, in virtual time."""

from benchmarks.benchmark import Benchmark
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from tests.support.scene_loops import REQUESTED_N, felt_under, jumping_n, slews_n_per_s

SCENES = ("radial", "tmcl_bench", "real_bench")
JUMPS, QUICK_JUMPS = 200, 20


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    rows, jumps = [], QUICK_JUMPS if benchmark.quick else JUMPS
    for name in SCENES:
        scene = load_scene(find_scene(name)).display
        tick_s = scene.tick_ns * 1e-9
        felt_n = felt_under(scene, jumping_n(jumps, tick_s))
        up, down = slews_n_per_s(felt_n, tick_s)
        rows.append((name, f"{felt_n.max():.3f}", f"{up:.1f}", f"{down:.1f}"))
    benchmark.table(
        f"{jumps} jumps to {', '.join(f'{force:g}' for force in REQUESTED_N)} N;"
        " 2.5 N and 50 N/s are allowed",
        ("scene", "most N", "up N/s", "down N/s"),
        rows,
    )
