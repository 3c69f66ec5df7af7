"""The paper's pulse on a physical stepper: scenes bench and real_bench, and variations of them.

The chapter shows the error that each imperfection of a real bench adds, and that each part of the
controller removes. The paper's own experiment (section 5, Figs 17 to 20) is run the same way for
the first chapter.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from display_node.plant.scene import FilmTable, StepperScene
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError
from sensing_node.scene import build_source
from telepulse.commissioning.tuning import judge
from telepulse.document import Chapter, Plot, Table
from telepulse.paper import published
from telepulse.paper.hard_case import refusal_reason
from telepulse.scene import Scene, load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Changes = dict[str, object]
SETTLING_S = 2.0
SHOWN_S = (3.0, 4.8)


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
    lead_ticks = loop.lead_ns / display.tick_ns
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


def run_imperfections() -> list[tuple[BenchResult, BenchResult]]:
    """Run each part of the real bench alone: on the film's reading, and with the observer."""
    real, ideal = load_bench(), FilmTable()
    actuator, film = _stepper(real), real.display.film
    no_rotor: Changes = {"rotor_resonance_hz": None}
    no_backlash: Changes = {"backlash_m": 0.0}
    still = actuator.model_copy(update=no_rotor | no_backlash)
    benches = {
        "none of them": (still, ideal),
        "film's filter, 40 Hz": (still, ideal.model_copy(update={"filter_hz": film.filter_hz})),
        "noise, 1 mN": (still, ideal.model_copy(update={"noise_n": film.noise_n})),
        "ADC, 16 bits of ±10 V at 44 mV/N": (
            still,
            film.model_copy(update={"filter_hz": None, "noise_n": 0.0}),
        ),
        "backlash, 10 µm": (actuator.model_copy(update=no_rotor), ideal),
        "rotor, 100 Hz, ζ 0.2": (actuator.model_copy(update=no_backlash), ideal),
        "all of them": (actuator, film),
    }
    results = []
    for name, (stepper, table) in benches.items():
        observed = _with(real, actuator=stepper, film=table)
        reading = _with_controller(observed, {"observer": None})
        results.append((_run(name, reading), _run(name, observed)))
    return results


def run_wrong_models() -> list[BenchResult]:
    """Run the real bench with a controller whose model of it is wrong."""
    real = load_bench()
    wrong: dict[str, Changes] = {
        "as modelled": {},
        "fingertip 20 % softer": {"fingertip_n_per_m": 800.0},
        "fingertip 20 % stiffer": {"fingertip_n_per_m": 1200.0},
        "fingertip half as stiff": {"fingertip_n_per_m": 500.0},
        "fingertip twice as stiff": {"fingertip_n_per_m": 2000.0},
        "no backlash": {"backlash_m": 0.0},
        "backlash of 20 µm": {"backlash_m": 20e-6},
        "rotor at 80 Hz": {"rotor_resonance_hz": 80.0},
        "rotor at 120 Hz": {"rotor_resonance_hz": 120.0},
        "rotor's ζ is 0.1": {"rotor_damping": 0.1},
        "tip of 3 mm": {"tip_radius_m": 3e-3},
    }
    actuator = _stepper(real)
    return [
        _run(name, real, actuator.model_copy(update=changes)) for name, changes in wrong.items()
    ]


def other_benches() -> list[BenchResult]:
    """Run other films, leads and loop rates than the shipped scenes have."""
    clean, real = load_bench("bench"), load_bench()
    films: dict[str, Changes] = {
        "real, film by eq 21: 5305 mV/N": {"sensitivity_v_per_n": None, "adc_range_v": 15.0},
        "real, filter of two poles": {"filter_order": 2},
        "real, filter at 20 Hz": {"filter_hz": 20.0},
    }
    benches = {}
    for mm in (1, 2, 6):
        lead = _stepper(clean).model_copy(update={"lead_m": mm * 1e-3})
        benches[f"clean, lead {mm} mm"] = _with(clean, actuator=lead)
    for rate_hz in (500, 200):
        # The pulse's samples come at the loop's rate.
        source = real.sensing.source.model_copy(update={"rate_hz": float(rate_hz)})
        slow = replace(real, sensing=real.sensing.model_copy(update={"source": source}))
        benches[f"real, {rate_hz} Hz loop"] = _with(slow, tick_ns=round(1e9 / rate_hz))
    for name, changes in films.items():
        benches[name] = _with(real, film=real.display.film.model_copy(update=changes))
    return [_run(name, scene) for name, scene in benches.items()]


def _run(name: str, scene: Scene, actual: StepperScene | None = None) -> BenchResult:
    try:
        return BenchResult(name, run_scene(scene, actual).force_rmse_n)
    except SceneError as error:
        return BenchResult(name, None, refusal_reason(error))


def _with(scene: Scene, **keys_of_display: object) -> Scene:
    return replace(scene, display=scene.display.model_copy(update=keys_of_display))


def _with_controller(scene: Scene, changes: Changes) -> Scene:
    return _with(scene, controller=scene.display.controller.model_copy(update=changes))


def _stepper(scene: Scene) -> StepperScene:
    return StepperScene.narrow(scene.display.actuator, f"{scene.path}: [display] actuator:")


def chapter() -> Chapter:
    """Run the benches. Raises SceneError or SourceError."""
    paragraphs = (
        "Eq 22 does not describe a stepping motor. Here a stepping motor presses the paper's pulse,"
        " 0.3 N peak to peak on an offset of 0.3 N: 1/16 microsteps on a lead of 2 mm, a rigid tip"
        " of 5 mm on 2 mm of rubber, a fingertip of 1 N/mm behind it. The clean bench has nothing"
        " else. The real bench adds 10 µm of backlash, a rotor that rings at 100 Hz"
        " (ζ 0.2), 1 mN of noise on the film, its 40 Hz filter, and a converter of 16 bits"
        " over ±10 V, which at Fig. 4's 44 mV/N is 6.9 mN a step. All errors are force RMSE"
        " over the first 6 s, as the paper's; the scenes are `scenes/bench.toml` and"
        " `scenes/real_bench.toml`.",
        "A stepper can do no better than one microstep: the nearest one at every tick would"
        f" leave {1e3 * microstep_rmse_n(load_bench('bench')):.2f} mN. The paper's experiment"
        f" printed {1e3 * published.MEASURED_FORCE.force_n:.1f} mN.",
        "Three things reduce the error. Feed-forward: the reference's next samples are known,"
        " so the screw moves to the position that contact, rotor and backlash require, before any"
        " error appears. An observer: models of drive and film run in step with them, so that the"
        " film's lag is not taken for an error. Adaptation: the finger's position and compliance"
        " are states of the observer's Kalman filter.",
        "Feed-forward alone makes the real bench worse than a plain gain does: the slow film"
        " reports the motion late, and the gain works against it.",
    )
    caption = (
        "The real bench: force at the finger when the controller takes the film's reading for the"
        " force, and with feed-forward and observer."
    )
    real = load_bench()
    on_film = _with_controller(real, {"observer": None, "feed_forward": False})
    reading, shipped = run_scene(on_film), run_scene(real)
    plot = Plot("real-bench", caption, lambda figure: _draw(figure, reading, shipped))
    finding = (
        f"On a model of a real stepper bench, the shipped controller leaves a force error of"
        f" {1e3 * shipped.force_rmse_n:.2f} mN of a pulse of 300 mN; the paper's experiment printed"
        f" {1e3 * published.MEASURED_FORCE.force_n:.1f} mN."
    )
    return Chapter(
        "The same pulse on a physical stepper", paragraphs, _tables(), (plot,), (finding,)
    )


def _tables() -> list[Table]:
    clean, real = load_bench("bench"), load_bench()
    on_clean = {result.name: str(result) for result in run_controllers(clean)}
    on_real = run_controllers(real)
    refused = [result.refused for result in on_real if result.refused]
    margins = []
    for name, display in (("clean bench", clean.display), ("real bench", real.display)):
        design = judge(display, display.controller)
        worst = design.worst
        margins.append(
            (
                name,
                f"{design.controller.kp:g} /s",
                f"{worst.gain:.3g}",
                f"{worst.phase_deg:.0f}°",
                f"{1e3 * worst.delay_s:.3g} ms",
                f"{worst.peak_sensitivity:.2f}",
            )
        )
    return [
        Table(
            "Force RMSE by what the controller models",
            ("controller", "clean bench", "real bench"),
            [(each.name, on_clean.get(each.name, "–"), str(each)) for each in on_real],
            f"Refused by the display: {'; '.join(refused)}." if refused else "",
        ),
        Table(
            "Error that each part of the real bench adds alone",
            ("part", "with feed-forward, on the film's reading", "with the observer"),
            [(reading.name, str(reading), str(seen)) for reading, seen in run_imperfections()],
        ),
        Table(
            "A wrong model of the real bench",
            ("the real bench has", "force RMSE"),
            [(each.name, str(each)) for each in run_wrong_models()],
        ),
        Table(
            "Other benches",
            ("bench", "force RMSE"),
            [(each.name, str(each)) for each in other_benches()],
        ),
        Table(
            "Margins of the two loops, as `telepulse tune` designs them",
            ("loop", "kp", "gain margin", "phase margin", "delay margin", "Ms"),
            margins,
            "The observer's gains solve a Riccati equation for the film's noise and a finger"
            " that wanders 20 µm in 1 s. kp minimises the effect of film noise and finger"
            " motion, as long as Ms stays at or below 1.4 and the drive may answer 5 ticks late.",
        ),
    ]


def _draw(figure: "Figure", reading: TrackingRun, shipped: TrackingRun) -> None:
    force, error = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    shown = (shipped.t_s >= SHOWN_S[0]) & (shipped.t_s < SHOWN_S[1])
    t_s = shipped.t_s[shown]
    force.plot(t_s, shipped.wanted_n[shown], label="wanted")
    force.plot(t_s, reading.felt_n[shown], label="proportional gain, film's reading")
    force.plot(t_s, shipped.felt_n[shown], "--", label="as shipped")
    force.set(ylabel="force in N", ylim=(0.2, 0.7))
    force.legend(loc="upper right", ncols=3)
    error.plot([], [])
    for run in (reading, shipped):
        error.plot(t_s, 1e3 * (run.felt_n - run.wanted_n)[shown])
    error.set(xlabel="time in s", ylabel="error in mN")
