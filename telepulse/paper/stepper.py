"""The paper's pulse on a physical stepper: scenes bench and real_bench, and variations of them.

They show the error that each imperfection of a real bench adds, and that each part of the
controller removes. The paper's own experiment (section 5, Figs 17 to 20) is run the same way.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.control.linear_loop import UnstableLoopError
from display_node.plant.scene import FilmTable, StepperScene
from protocol.config.scene_file import find_scene
from protocol.tactile import Adc, ElasticLayer
from sensing_node.scene import build_source
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.document import Table
from telepulse.paper import published
from telepulse.scene import Scene, load_scene

Floats = NDArray[np.float64]
Changes = dict[str, object]
SETTLING_S = 2.0


@dataclass(frozen=True, slots=True)
class TrackingRun:
    """Target and felt force in N at times in s; the felt force at the beginning of each tick."""

    t_s: Floats
    wanted_n: Floats
    felt_n: Floats

    @property
    def force_rmse_n(self) -> float:
        """RMSE in N by eqs 23-25."""
        return float(np.sqrt(np.mean((self.felt_n - self.wanted_n) ** 2)))


def run_scene(scene: Scene, actual: StepperScene | None = None) -> TrackingRun:
    """Run the first 6 s of a pulse after the loop has settled at the pulse's first force.

    The scene's link, playout and slew limit are left out, since the paper had none. `actual` is
    the simulated stepper, if it differs from the one that the controller assumes.

    Raises
    ------
    SceneError, SourceError
        The loop is refused, or the source cannot be read.
    """
    display, tick_s = scene.display, scene.display.tick_ns * 1e-9
    safety = display.safety.model_copy(update={"slew_limit_n_per_s": math.inf})
    loop = display.model_copy(update={"safety": safety}).force_loop(actual)
    ticks, reach = round(published.FIRST_S / tick_s), loop.horizon + 1
    lead_ticks = loop.actuation_delay_ns / display.tick_ns
    samples = ticks + reach + math.ceil(lead_ticks)
    wanted_n = build_source(scene.sensing, scene.path.parent).take(samples)[:, 0]
    at = np.arange(samples)
    reference_n = np.interp(at + lead_ticks, at, wanted_n).tolist()
    for _ in range(round(SETTLING_S / tick_s)):
        loop.tick(reference_n[:1] * reach, loop.read_film())
    felt_n = []
    for tick in range(ticks):
        felt_n.append(loop.felt_n)
        loop.tick(reference_n[tick : tick + reach], loop.read_film())
    t_s = np.arange(ticks, dtype=np.float64) * tick_s
    return TrackingRun(t_s, wanted_n[:ticks], np.array(felt_n))


@dataclass(frozen=True, slots=True)
class BenchResult:
    """A bench and its force RMSE in N, or the reason why its loop was refused."""

    name: str
    force_rmse_n: float | None
    refused: str = ""

    def __str__(self) -> str:
        return "refused" if self.force_rmse_n is None else f"{1e3 * self.force_rmse_n:.2f} mN"


def load_bench(name: str = "real_bench") -> Scene:
    """Load a shipped stepper bench; "bench" is the one without imperfections. Raises SceneError."""
    return load_scene(find_scene(name))


def microstep_rmse_n(scene: Scene) -> float:
    """Return the RMSE in N of the nearest microstep at each tick: no controller can be better."""
    actuator = _stepper(scene)
    law, step_m = actuator.contact(scene.display.layer.layer()), actuator.step_m
    wanted_n = build_source(scene.sensing, scene.path.parent).take(6000)[:, 0]
    felt_n = np.array([law.force(round(law.position(n) / step_m) * step_m) for n in wanted_n])
    return float(np.sqrt(np.mean((felt_n - wanted_n) ** 2)))


def run_controllers(scene: Scene) -> list[BenchResult]:
    """Run the scene's bench under controllers that model more of it, step by step."""
    ours = scene.display.controller
    on_film: Changes = {"observer": None, "feed_forward": False}
    paper_gains: Changes = {"kp": 15.0, "ki": 0.15, "kd": 0.03, "error": "millivolts"}
    steps: dict[str, Changes] = {
        "the paper's PID gains, on the film's reading in mV": on_film | paper_gains,
        "proportional gain, on the film's reading": on_film,
        "+ feed-forward with preview": {"observer": None},
    }
    if ours.observer is not None:
        fixed = ours.observer.model_copy(update={"softening": 0.0})
        steps["+ observer instead of the film's reading"] = {"observer": fixed}
        steps["+ observer adapts to the finger (as shipped)"] = {}
    return [_run(name, _with_controller(scene, changes)) for name, changes in steps.items()]


def _run(name: str, scene: Scene, actual: StepperScene | None = None) -> BenchResult:
    try:
        return BenchResult(name, run_scene(scene, actual).force_rmse_n)
    except UnstableLoopError as error:
        return BenchResult(name, None, error.reason)


def _with(scene: Scene, **keys_of_display: object) -> Scene:
    return replace(scene, display=scene.display.model_copy(update=keys_of_display))


def _with_controller(scene: Scene, changes: Changes) -> Scene:
    return _with(scene, controller=scene.display.controller.model_copy(update=changes))


def _stepper(scene: Scene) -> StepperScene:
    return StepperScene.narrow(scene.display.actuator, f"{scene.path}: [display] actuator:")


def run_on_film(scene: Scene) -> TrackingRun:
    """Run a bench whose controller takes the film's reading for the force."""
    return run_scene(_with_controller(scene, {"observer": None, "feed_forward": False}))


class BenchDescription(NamedTuple):
    """Parts of the real bench, its converter's step, and the clean bench's error by microsteps."""

    source: SyntheticScene
    motor: StepperScene
    film: FilmTable
    layer: ElasticLayer
    adc_step_n: float
    clean_microstep_n: float


def describe(real: Scene) -> BenchDescription:
    """Return what the report says of the benches."""
    film = real.display.film
    adc_step_v = 0.0 if film.adc_bits is None else Adc(film.adc_bits, film.adc_range_v).step_volts
    return BenchDescription(
        SyntheticScene.narrow(real.sensing.source, f"{real.path}: [sensing] source:"),
        _stepper(real),
        film,
        real.display.layer.layer(),
        adc_step_v / film.volts_per_newton,
        microstep_rmse_n(load_bench("bench")),
    )


def tables() -> dict[str, Table]:
    """Run the benches, and return their errors and the margins of their loops."""
    clean, real = load_bench("bench"), load_bench()
    on_clean = {result.name: str(result) for result in run_controllers(clean)}
    on_real = run_controllers(real)
    refused = [result.refused for result in on_real if result.refused]
    return {
        "controllers": Table(
            "",
            ("controller", "clean bench", "real bench"),
            [(each.name, on_clean.get(each.name, "–"), str(each)) for each in on_real],
            f"Refused by the display: {'; '.join(refused)}." if refused else "",
        ),
    }
