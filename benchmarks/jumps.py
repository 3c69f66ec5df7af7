"""Felt force where a peer's forces jump beyond all limits, in virtual time.

The second table compares input shapers for the rotor that rings on `real_bench`: what they let
through, and what they cost in error and delay.
"""

import math
from collections.abc import Callable
from unittest.mock import patch

import numpy as np

from benchmarks.benchmark import Benchmark
from display_node.control import feed_forward
from display_node.control.shaper import rotor_rings, shaper_weights, zero_vibration
from display_node.plant.scene import StepperScene
from display_node.plant.stepper import Rotor
from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from telepulse.paper.stepper import load_bench, run_scene
from telepulse.scene import load_scene
from tests.support.scene_loops import (
    REQUESTED_N,
    felt_under,
    jumping_n,
    other_rotors,
    slews_n_per_s,
    swinging_n,
)

SCENES = ("radial", "tmcl_bench", "real_bench")
JUMPS = 200
COMPARED_JUMPS = 40
# Periods of forces that swing, around that of the resonance.
PERIODS = (6, 8, 10, 12, 14, 20)
SWING_TICKS = 600
# A slight touch for some ticks, before the observer has learnt the finger, and then a jump.
TOUCH_N, TOUCH_TICKS, JUMP_TICKS = 0.05, range(0, 40, 3), 60
Weights = Callable[[float, float, float], list[float]]


def _zeros(*shares: float, average_ticks: int = 1) -> Weights:
    """Return a shaper with zeros at shares of the resonance, and a moving average."""

    def weights(resonance_hz: float, damping: float, tick_s: float) -> list[float]:
        total = np.full(average_ticks, 1 / average_ticks)
        for share in shares:
            total = np.convolve(total, zero_vibration(share * resonance_hz, damping, tick_s))
        return total.tolist()

    return weights


SHAPERS: dict[str, Weights | None] = {
    "none: the rotor's inverse": None,
    "zero vibration (ZV)": _zeros(1.0),
    "ZV and derivative (ZVD)": _zeros(1.0, 1.0),
    "zeros at 1/1.2 and 1.2": _zeros(1 / 1.2, 1.2),
    "zeros at 1/1.2, 1 and 1.2": _zeros(1 / 1.2, 1.0, 1.2),
    "and steps in three (shipped)": shaper_weights,
    "and an average of 5 ms": _zeros(1 / 1.2, 1.0, 1.2, average_ticks=5),
}


def main(benchmark: Benchmark) -> None:
    """Print both tables."""
    rows = []
    for name in SCENES:
        scene = load_scene(find_scene(name)).display
        tick_s = scene.tick_ns * 1e-9
        felt_n = felt_under(scene, jumping_n(JUMPS, tick_s))
        up, down = slews_n_per_s(felt_n, tick_s)
        rows.append((name, f"{felt_n.max():.3f}", f"{up:.1f}", f"{down:.1f}"))
    benchmark.table(
        f"{JUMPS} jumps to {', '.join(f'{force:g}' for force in REQUESTED_N)} N;"
        " 2.5 N and 50 N/s are allowed",
        ("scene", "most N", "up N/s", "down N/s"),
        rows,
    )
    benchmark.table(
        f"shapers for the rotor of real_bench: greatest felt slew in N/s under {COMPARED_JUMPS}"
        " jumps, under forces that swing near the resonance, and in a jump soon after first touch;"
        " with the rotor as modelled, and the worst of six others (resonance ±20 %, damping"
        " ±20 %)",
        (
            *("shaper", "delay ms", "linear bound", "jumps", "others", "swings", "others"),
            *("first touch", "others", "error mN"),
        ),
        [_compare(name, weights) for name, weights in SHAPERS.items()],
    )


def _compare(name: str, weights: Weights | None) -> tuple[str, ...]:
    """Return a row of the second table."""
    bench = load_bench()
    scene, stepper = bench.display, bench.display.actuator
    assert isinstance(stepper, StepperScene)
    assert stepper.rotor_resonance_hz is not None
    tick_s, others = scene.tick_ns * 1e-9, list(other_rotors(stepper))
    jumps_n = list(jumping_n(COMPARED_JUMPS, tick_s))
    swings_n = [list(swinging_n(each, SWING_TICKS)) for each in PERIODS]
    touches_n = [[TOUCH_N] * ticks + [1e30] * JUMP_TICKS for ticks in TOUCH_TICKS]
    rings = rotor_rings if weights is not None else lambda *_: False
    slews: list[float] = []
    with (
        patch.object(feed_forward, "rotor_rings", rings),
        patch.object(feed_forward, "shaper_weights", weights),
    ):
        delay_ms = scene.force_loop().lead_ns * 1e-6
        for forces_n in ([jumps_n], swings_n, touches_n):
            slews.append(_slew(scene, forces_n, stepper))
            slews.append(max(_slew(scene, forces_n, each) for each in others))
        error_n = run_scene(bench).force_rmse_n
    bound = ""
    if weights is not None:
        taps = weights(stepper.rotor_resonance_hz, stepper.rotor_damping, tick_s)
        bound = f"{max(_speed_gain(taps, each, tick_s) for each in (stepper, *others)):.3f}"
    cells = (f"{slew:.1f}" for slew in slews)
    return (name, f"{delay_ms:.2f}", bound, *cells, f"{error_n * 1e3:.3f}")


def _slew(scene: DisplayScene, forces_n: list[list[float]], actual: StepperScene) -> float:
    """Return the greatest felt slew in N/s, up or down, under each of some requested forces."""
    tick_s = scene.tick_ns * 1e-9
    felt_n = [felt_under(scene, requested_n, actual) for requested_n in forces_n]
    return max(slew for each_n in felt_n for slew in slews_n_per_s(each_n, tick_s))


def _speed_gain(weights: list[float], actual: StepperScene, tick_s: float) -> float:
    """Return the rotor's greatest speed over that of a path before the shaper, for any path."""
    rotor = Rotor(actual.rotor_resonance_hz or math.nan, actual.rotor_damping, tick_s)
    places_m, from_m = [0.0], 0.0
    for to_m in [*np.cumsum(weights).tolist(), *[1.0] * 600]:
        places_m.append(rotor.step(from_m, to_m))
        from_m = to_m
    return float(np.abs(np.diff(places_m)).sum())
