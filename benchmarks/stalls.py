"""Peak force at the finger when the host stalls, in virtual time.

The pulse is a half sine of 0.53 N, far steeper than a wrist's. Before a tick the host misses a
number of ticks, drawn uniformly from 1 to the longest stall.
"""

from unittest.mock import patch

from benchmarks.benchmark import Benchmark
from display_node.control.controller import StallGuard
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from tests.support.scene_loops import PEAK_N, Host, press, stalls_always, stalls_at_times

SECONDS = 30.0
SCENES = ("radial", "real_bench", "tmcl_bench")
HOSTS: dict[str, Host] = {
    "none": stalls_always(0),
    "1 to 4, 5 % of ticks": lambda rng, _: rng.randint(1, 4) if rng.random() < 0.05 else 0,
    "1 to 6, always": stalls_always(6),
    "1 to 20, always": stalls_always(20),
    "1 to 45, always": stalls_always(45),
    "1 to 45, 3 s in 10": stalls_at_times(45),
    "30, once in 5 s": lambda rng, _: 30 if rng.random() < 2e-4 else 0,
}


def main(benchmark: Benchmark) -> None:
    """Print the table; the force limit is 2.5 N."""
    rows = []
    for name in SCENES:
        scene = load_scene(find_scene(name)).display
        for stalls, host in HOSTS.items():
            most_n, rmse_n = press(scene, host, SECONDS)
            with patch.object(StallGuard, "tick", lambda *_: None):
                free_most_n, free_rmse_n = press(scene, host, SECONDS)
            cells = (f"{most_n:.2f}", f"{free_most_n:.2f}")
            errors = (f"{rmse_n * 1e3:.2f}", f"{free_rmse_n * 1e3:.2f}")
            rows.append((name, stalls, *cells, *errors))
    benchmark.table(
        f"Stalls of a host, {SECONDS:g} s each: a beat of {PEAK_N} N is wanted",
        ("scene", "ticks missed", "most N", "unguarded", "RMSE mN", "unguarded"),
        rows,
    )
