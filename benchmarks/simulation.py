"""Speed of `telepulse simulate` as a multiple of real time, on one core."""

import statistics

from benchmarks.benchmark import Benchmark
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from telepulse.simulation.virtual_time import summarise

SECONDS = 20.0
REPEATS = 5


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    seconds, repeats = (1.0, 1) if benchmark.quick else (SECONDS, REPEATS)
    scene = load_scene(find_scene("radial"))
    speeds = [summarise(scene, seconds, seed=1).speed or 0.0 for _ in range(repeats)]
    speed = statistics.median(speeds)
    benchmark.table(
        f"Simulation of {seconds:g} s: times real time, median of {repeats}",
        ("scene", "speed", "range"),
        [("radial (default)", f"{speed:.0f}", f"{min(speeds):.0f} to {max(speeds):.0f}")],
    )
    benchmark.judge("speed of the default scene, times real time", speed)
