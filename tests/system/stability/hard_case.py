"""Runs of the shipped force loop as a display makes them, and what they must have come to."""

from collections.abc import Callable, Mapping

import numpy as np

from display_node.control.force_bounds import ForceBounds
from display_node.control.link_loss import Fade
from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from protocol.faults import Fault
from protocol.tactile import Adc
from telepulse.paper import published
from telepulse.paper.stability import BOUND_N, HELD_N, SAFETY, Array, paper_setup
from telepulse.scene import load_scene

SceneTable = Mapping[str, object]
# The paper's actuator (eq 22) has no microsteps; it has settled within this share of the force.
SETTLED_SHARE = 0.01
# Standard deviations of the film's noise that are allowed for.
NOISE_DEVIATIONS = 4.0
# Below this the force counts as 0.
AT_REST_N = 1e-3


def make_setup(
    controller: SceneTable,
    actuator: SceneTable,
    film: SceneTable | None = None,
    layer: SceneTable | None = None,
) -> DisplayScene:
    """Make a display from tables as a scene has them; the layer is Table 3's by default."""
    tables = {"controller": controller, "actuator": actuator, "film": film or {}}
    return DisplayScene.model_validate(tables | {"layer": layer or {}, "safety": SAFETY})


def scene_setup(name: str) -> DisplayScene:
    """Return the display of a shipped scene, with the shortest ramp."""
    return load_scene(find_scene(name)).display.model_copy(update={"safety": SAFETY})


# The displays that most cases share.
COMMON = {
    "eq 22": paper_setup(published.EXPERIMENT),
    "bench": scene_setup("bench"),
    "real_bench": scene_setup("real_bench"),
}


def run(
    setup: DisplayScene,
    reference: Callable[[int], float] = lambda _: HELD_N,
    reading: Callable[[int, float], float] = lambda _, reading_n: reading_n,
    with_safety: bool = True,
    ticks: int = 2000,
) -> tuple[Array, list[Fault]]:
    """Run the loop from rest, tick by tick.

    reference: target force in N at a tick. reading: of the film for the controller in N, from the
    tick and the film's own. with_safety: fade and force bounds apply to both. Returns
    the felt force in N at each tick's end, and the latched faults. Raises SceneError.
    """
    loop, tick_ns = setup.force_loop(), setup.tick_ns
    fade, bounds = Fade(SAFETY, tick_ns), ForceBounds(SAFETY, tick_ns)
    reach, felt_n = range(loop.horizon + 1), []
    for tick in range(ticks):
        wanted_n = [reference(tick + ahead) for ahead in reach]
        reading_n = reading(tick, loop.read_film())
        if with_safety:
            if (fault := bounds.reading_fault(reading_n, 1)) is not None:
                fade.fault(fault)
            wanted_n = bounds.bound(wanted_n, fade.advance(alive=True))
        loop.tick(wanted_n, reading_n)
        felt_n.append(loop.felt_n)
    return np.array(felt_n), fade.faults


def settled_range_n(
    setup: DisplayScene, force_n: float, microsteps: float = 1.0
) -> tuple[float, float]:
    """Return the least and greatest force in N at which a loop has settled on `force_n`.

    A stepper: within `microsteps` and the dead band, plus noise and quantisation of the film.
    The paper's actuator: within 1 %.
    """
    actuator, controller, film = setup.actuator, setup.controller, setup.film
    if (stepper := actuator.stepper) is None:
        return (1 - SETTLED_SHARE) * force_n, (1 + SETTLED_SHARE) * force_n
    law = stepper.contact(setup.layer.layer())
    x_m, step_m = law.position(force_n), microsteps * stepper.step_m
    error_per_m = 1.0
    if controller.error != "position":
        error_per_m = controller.error_per_newton(film) * law.stiffness(force_n)
    step_m += controller.dead_band / error_per_m
    off_n = NOISE_DEVIATIONS * film.noise_n
    if film.adc_bits is not None:
        off_n += Adc(film.adc_bits, film.adc_range_v).step_volts / film.volts_per_newton
    rounding_m = 1e-9 * (x_m + step_m)
    low_n = law.force(x_m - step_m - rounding_m)
    return low_n - off_n, law.force(x_m + step_m + rounding_m) + off_n


def assert_settled(
    setup: DisplayScene, felt_n: Array, force_n: float = HELD_N, microsteps: float = 1.0
) -> None:
    """Check that a force was within bounds, and at its target in the last quarter."""
    assert np.isfinite(felt_n).all()
    assert np.abs(felt_n).max() <= BOUND_N
    low_n, high_n = settled_range_n(setup, force_n, microsteps)
    end_n = felt_n[-len(felt_n) // 4 :]
    assert low_n <= end_n.min() <= end_n.max() <= high_n


def assert_comes_to_rest(setup: DisplayScene, felt_n: Array, fault_tick: int) -> None:
    """Check that a force did not rise after a fault, and is 0 N for good."""
    assert np.isfinite(felt_n).all()
    assert np.abs(felt_n).max() <= BOUND_N
    # It may rise for two ticks, at most at the slew limit: one until the drive has the command,
    # one until it reverses.
    slack_n = 2 * SAFETY.slew_limit_n_per_s * setup.tick_ns * 1e-9
    assert felt_n[fault_tick:].max() <= felt_n[fault_tick - 1] + slack_n
    assert np.abs(felt_n[-len(felt_n) // 4 :]).max() <= AT_REST_N
