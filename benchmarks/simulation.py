"""Speed of `telepulse simulate` as a multiple of real time, on one core."""

import statistics
from dataclasses import replace

from benchmarks.benchmark import Benchmark
from protocol.config.scene import Section
from protocol.config.scene_file import find_scene
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import summarise

SECONDS = 20.0
REPEATS = 5


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    seconds, repeats = (1.0, 1) if benchmark.quick else (SECONDS, REPEATS)
    radial = load_scene(find_scene("radial"))
    controller = radial.display.controller
    scenes = {
        "radial (default)": radial,
        "radial over 40±10 ms, 1 % loss": replace(
            radial, link=parse_link("delay=40ms,jitter=10ms,loss=1%")
        ),
        "radial without feed-forward": _display(
            radial, controller=_with(controller, feed_forward=False)
        ),
        "radial with a derivative": _display(radial, controller=_with(controller, kd=0.01)),
        "paper (second-order actuator)": load_scene(find_scene("paper")),
    }
    base = 0.0
    rows = []
    for name, scene in scenes.items():
        speeds = [summarise(scene, seconds, seed=1).speed or 0.0 for _ in range(repeats)]
        speed = statistics.median(speeds)
        base = base or speed
        rows.append(
            (name, f"{speed:.0f}", f"{min(speeds):.0f} to {max(speeds):.0f}", f"{speed / base:.2f}")
        )
    benchmark.table(
        f"Simulation of {seconds:g} s: times real time, median of {repeats}",
        ("scene", "speed", "range", "over default"),
        rows,
    )
    benchmark.judge("speed of the default scene, times real time", base)


def _with(section: Section, **changes: object) -> Section:
    return section.model_copy(update=changes)


def _display(scene: Scene, **changes: object) -> Scene:
    return replace(scene, display=scene.display.model_copy(update=changes))
