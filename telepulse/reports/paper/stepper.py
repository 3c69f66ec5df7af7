"""The paper's pulse on a physical stepper: scenes bench and real_bench, and variations of them.

Each part of a real bench adds to the error, and each part of the controller takes some of it away.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from display_node.plant.film import FilmTable
from display_node.plant.stepper import StepperScene
from protocol.config.scene import Section, SectionT
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError
from sensing_node.scene import build_source
from telepulse.commissioning.tuning import judge
from telepulse.reports.document import Chapter, Plot, Table
from telepulse.reports.paper import experiment, published
from telepulse.reports.paper.experiment import TrackingRun
from telepulse.scene import Scene, load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_S = (3.0, 4.8)


@dataclass(frozen=True, slots=True)
class BenchResult:
    """A bench and its force RMSE in N, or the reason why its loop was refused."""

    name: str
    force_rmse_n: float | None
    refused: str = ""

    def __str__(self) -> str:
        if self.force_rmse_n is None:
            return "refused"
        return f"{1e3 * self.force_rmse_n:.2f} mN"


def clean_bench() -> Scene:
    """Load a physical stepper whose film is read without error. Raises SceneError."""
    return load_scene(find_scene("bench"))


def real_bench() -> Scene:
    """Load a stepper with backlash, a ringing rotor and a slow, noisy, coarse film.

    Raises SceneError.
    """
    return load_scene(find_scene("real_bench"))


def floor_n(scene: Scene) -> float:
    """Return the RMSE in N of the nearest microstep, the least that a controller can reach."""
    actuator = _stepper(scene)
    law, step_m = actuator.contact(scene.display.layer.layer()), actuator.step_m
    wanted_n = build_source(scene.sensing, scene.path.parent).take(6000)[:, 0]
    felt_n = np.array([law.force(round(law.position(n) / step_m) * step_m) for n in wanted_n])
    return float(np.sqrt(np.mean((felt_n - wanted_n) ** 2)))


def controllers(scene: Scene) -> list[BenchResult]:
    """Run the scene's bench under controllers that model more and more of it."""
    ours = scene.display.controller
    reading: dict[str, object] = {"observer": None, "feed_forward": False}
    papers: dict[str, object] = {"kp": 15.0, "ki": 0.15, "kd": 0.03, "error": "millivolts"}
    steps: dict[str, dict[str, object]] = {
        "the paper's PID gains, on the film's reading in mV": reading | papers,
        "proportional gain, on the film's reading": reading,
        "and feed-forward with preview": {"observer": None},
    }
    results = [
        _run(name, _with(scene, controller=_changed(ours, changes)))
        for name, changes in steps.items()
    ]
    if ours.observer is None:
        return results
    fixed = _changed(ours, {"observer": _changed(ours.observer, {"softening": 0.0})})
    return [
        *results,
        _run("and an observer in the reading's place", _with(scene, controller=fixed)),
        _run("and it learns the finger: the scene as shipped", scene),
    ]


def parts() -> list[tuple[BenchResult, BenchResult]]:
    """Run each part of the real bench alone: on the film's reading, and with the observer."""
    real = real_bench()
    actuator, film, ideal = _stepper(real), real.display.film, FilmTable()
    still = _changed(actuator, {"rotor_resonance_hz": None, "backlash_m": 0.0})
    benches: dict[str, tuple[StepperScene, FilmTable]] = {
        "none of them": (still, ideal),
        "film's filter, 40 Hz": (still, _changed(ideal, {"filter_hz": film.filter_hz})),
        "noise, 1 mN": (still, _changed(ideal, {"noise_n": film.noise_n})),
        "ADC, 16 bits of ±10 V at 44 mV/N": (
            still,
            _changed(film, {"filter_hz": None, "noise_n": 0.0}),
        ),
        "backlash, 10 µm": (_changed(actuator, {"rotor_resonance_hz": None}), ideal),
        "rotor, 100 Hz, ζ 0.2": (_changed(actuator, {"backlash_m": 0.0}), ideal),
        "all of them": (actuator, film),
    }
    without_observer = _changed(real.display.controller, {"observer": None})
    return [
        (
            _run(name, _with(real, actuator=stepper, film=table, controller=without_observer)),
            _run(name, _with(real, actuator=stepper, film=table)),
        )
        for name, (stepper, table) in benches.items()
    ]


def mistakes() -> list[BenchResult]:
    """Run the real bench with a controller whose model of it is wrong."""
    real = real_bench()
    stepper = _stepper(real)
    wrong: dict[str, dict[str, float]] = {
        "nothing": {},
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
    return [_run(name, real, _changed(stepper, changes)) for name, changes in wrong.items()]


def other_benches() -> list[BenchResult]:
    """Run other films, leads and loop rates than the shipped scenes have."""
    clean, real = clean_bench(), real_bench()
    stepper, film = _stepper(clean), real.display.film
    films: dict[str, dict[str, object]] = {
        "real, film by eq 21: 5305 mV/N": {"sensitivity_v_per_n": None, "adc_range_v": 15.0},
        "real, filter of two poles": {"filter_order": 2},
        "real, filter at 20 Hz": {"filter_hz": 20.0},
    }
    benches = {
        f"clean, lead {mm} mm": _with(clean, actuator=_changed(stepper, {"lead_m": mm * 1e-3}))
        for mm in (1, 2, 6)
    }
    benches |= {f"real, {rate_hz} Hz loop": _at_rate(real, rate_hz) for rate_hz in (500, 200)}
    benches |= {name: _with(real, film=_changed(film, of)) for name, of in films.items()}
    return [_run(name, scene) for name, scene in benches.items()]


def tracking() -> tuple[TrackingRun, TrackingRun]:
    """Run the real bench on the film's reading alone, and as shipped."""
    real = real_bench()
    reading = _changed(real.display.controller, {"observer": None, "feed_forward": False})
    return experiment.run(_with(real, controller=reading)), experiment.run(real)


def _run(name: str, scene: Scene, actual: StepperScene | None = None) -> BenchResult:
    try:
        return BenchResult(name, experiment.run(scene, actual).force_rmse_n)
    except SceneError as error:
        return BenchResult(name, None, str(error))


def _with(scene: Scene, **parts_of_display: Section) -> Scene:
    return replace(scene, display=_changed(scene.display, parts_of_display))


def _changed(section: SectionT, changes: Mapping[str, object]) -> SectionT:
    return section.model_copy(update=dict(changes))


def _stepper(scene: Scene) -> StepperScene:
    actuator = scene.display.actuator
    if not isinstance(actuator, StepperScene):
        raise SceneError(f"{scene.path}: [display] actuator: a stepper is needed here")
    return actuator


def _at_rate(scene: Scene, rate_hz: int) -> Scene:
    """Return the scene with its loop, and its pulse's samples, at another rate."""
    source = _changed(scene.sensing.source, {"rate_hz": float(rate_hz)})
    sensing = _changed(scene.sensing, {"source": source})
    display = _changed(scene.display, {"tick_ns": round(1e9 / rate_hz)})
    return replace(scene, sensing=sensing, display=display)


def chapter() -> Chapter:
    """Run the benches. Raises SceneError or SourceError."""
    floor_mn = 1e3 * floor_n(clean_bench())
    papers_mn = 1e3 * published.EXPERIMENT_FORCE_RMSE_N
    return Chapter(
        "The same pulse on a physical stepper",
        (
            "Eq 22 is not a stepping motor. Here a stepping motor presses the paper's pulse, 0.3 N"
            " from peak to peak on 0.3 N: 1/16 microsteps on a lead of 2 mm, a rigid tip of 5 mm"
            " on 2 mm of rubber, a fingertip of 1 N/mm behind it. The clean bench has nothing"
            " else. The real bench adds 10 µm of backlash, a rotor that rings at 100 Hz"
            " (ζ 0.2), 1 mN of noise on the film, its 40 Hz filter, and a converter of 16 bits"
            " over ±10 V, which at Fig. 4's 44 mV/N is 6.9 mN a step. All errors are force RMSE"
            " over the first 6 s, as the paper's; the scenes are bench and real_bench.",
            "A stepper can do no better than one microstep: the nearest one at every tick would"
            f" leave {floor_mn:.2f} mN. The paper's experiment printed {papers_mn:.1f} mN.",
            "Three things reduce the error. Feed-forward: the reference's next samples are known,"
            " so the screw is driven to where contact, rotor and backlash will need it, before any"
            " error appears. An observer: models of drive and film are stepped along, so that the"
            " film's lag is not mistaken for an error. Adaptation: the finger's place and softness"
            " are states of the observer's Kalman filter.",
            "Feed-forward alone makes the real bench worse than a plain gain does: the slow film"
            " reports the motion late, and the gain works against it.",
        ),
        (
            _controllers_table(),
            Table(
                "Error that each part of the real bench adds alone",
                ("part", "with feed-forward, on the film's reading", "with the observer"),
                tuple((reading.name, str(reading), str(observed)) for reading, observed in parts()),
            ),
            _list_table("A wrong model of the real bench", "it is really", mistakes()),
            _list_table("Other benches", "bench", other_benches()),
            _margins_table(),
        ),
        (_plot(*tracking()),),
    )


def _controllers_table() -> Table:
    clean, real = controllers(clean_bench()), controllers(real_bench())
    on_clean = {result.name: str(result) for result in clean}
    refused = [result.refused for result in real if result.refused]
    return Table(
        "Force RMSE by what the controller models",
        ("controller", "clean bench", "real bench"),
        tuple((each.name, on_clean.get(each.name, "–"), str(each)) for each in real),
        note="Refused: " + "; ".join(refused) if refused else "",
    )


def _list_table(title: str, first: str, results: list[BenchResult]) -> Table:
    return Table(title, (first, "force RMSE"), tuple((each.name, str(each)) for each in results))


def _margins_table() -> Table:
    def row(name: str, scene: Scene) -> tuple[str, ...]:
        design = judge(scene.display, scene.display.controller)
        worst = design.worst
        return (
            name,
            f"{design.controller.kp:g} /s",
            f"{worst.gain:.3g}",
            f"{worst.phase_deg:.0f}°",
            f"{1e3 * worst.delay_s:.3g} ms",
            f"{worst.peak_sensitivity:.2f}",
        )

    return Table(
        "Margins of the two loops, as `telepulse tune` designs them",
        ("loop", "kp", "gain margin", "phase margin", "delay margin", "Ms"),
        (row("clean bench", clean_bench()), row("real bench", real_bench())),
        note="The observer's gains solve a Riccati equation for the film's noise and a finger"
        " that wanders 20 µm in 1 s. kp minimises the effect of both on the felt force, as long as"
        " Ms stays at or below 1.4 and the drive may answer 5 ticks late.",
    )


def _plot(reading: TrackingRun, shipped: TrackingRun) -> Plot:
    def draw(figure: "Figure") -> None:
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

    return Plot(
        "real-bench",
        "The real bench: force at the finger with the film's reading taken for the force, and"
        " with feed-forward and observer.",
        draw,
    )
