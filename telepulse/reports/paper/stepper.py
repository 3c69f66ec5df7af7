"""The paper's pulse on a physical stepper: what each part of a real bench costs, and what each
part of the controller gains back. Scenes bench and real_bench, and variations of them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from display_node.plant.film import FilmTable
from display_node.plant.stepper import StepperScene
from protocol.config.scene import Section, SectionT
from protocol.errors import SceneError
from sensing_node.scene import build_source
from telepulse.reports.paper import experiment
from telepulse.reports.paper.experiment import ExperimentRun
from telepulse.scene import Scene, find_scene, load_scene


@dataclass(frozen=True, slots=True)
class StepperTrial:
    """A bench and what came of it: a force RMSE in N, or the reason why it was refused."""

    name: str
    force_rmse_n: float | None
    refused: str = ""


def clean_bench() -> Scene:
    """A physical stepper whose film is read as it is. Raises SceneError."""
    return load_scene(find_scene("bench"))


def real_bench() -> Scene:
    """Backlash, a rotor that rings, a slow, noisy and coarse film. Raises SceneError."""
    return load_scene(find_scene("real_bench"))


def floor_n(scene: Scene) -> float:
    """RMSE of the nearest microstep, the least that any controller can reach, in N."""
    actuator = _stepper(scene)
    law, step_m = actuator.contact(scene.display.layer.layer()), actuator.step_m
    wanted_n = build_source(scene.sensing, scene.path.parent).take(6000)[:, 0]
    felt_n = np.array([law.force(round(law.position(n) / step_m) * step_m) for n in wanted_n])
    return float(np.sqrt(np.mean((felt_n - wanted_n) ** 2)))


def controllers(scene: Scene) -> list[StepperTrial]:
    """The scene's bench under controllers that know more and more of it."""
    ours = scene.display.controller
    reading: dict[str, object] = {"observer": None, "feed_forward": False}
    papers: dict[str, object] = {"kp": 15.0, "ki": 0.15, "kd": 0.03, "error": "millivolts"}
    steps: dict[str, dict[str, object]] = {
        "the paper's PID gains, on the film's reading in mV": reading | papers,
        "proportional gain, on the film's reading": reading,
        "and feed-forward with preview": {"observer": None},
    }
    trials = [
        _try(name, _with(scene, controller=_changed(ours, changes)))
        for name, changes in steps.items()
    ]
    if ours.observer is None:
        return trials
    sure = _changed(ours.observer, {"softening": 0.0})
    return [
        *trials,
        _try(
            "and an observer in the reading's place",
            _with(scene, controller=_changed(ours, {"observer": sure})),
        ),
        _try("and it learns the finger: the scene as shipped", scene),
    ]


def parts() -> list[tuple[StepperTrial, StepperTrial]]:
    """Each part of the real bench alone: on the film's reading, and with the observer."""
    real = real_bench()
    actuator, film = _stepper(real), real.display.film
    still: dict[str, object] = {"rotor_resonance_hz": None, "backlash_m": 0.0}
    benches: dict[str, tuple[StepperScene, FilmTable]] = {
        "none of them": (_changed(actuator, still), FilmTable()),
        "film's filter, 40 Hz": (
            _changed(actuator, still),
            _changed(FilmTable(), {"filter_hz": film.filter_hz}),
        ),
        "noise, 1 mN": (
            _changed(actuator, still),
            _changed(FilmTable(), {"noise_n": film.noise_n}),
        ),
        "ADC, 16 bits of ±10 V at 44 mV/N": (
            _changed(actuator, still),
            _changed(film, {"filter_hz": None, "noise_n": 0.0}),
        ),
        "backlash, 10 µm": (_changed(actuator, {"rotor_resonance_hz": None}), FilmTable()),
        "rotor, 100 Hz, ζ 0.2": (_changed(actuator, {"backlash_m": 0.0}), FilmTable()),
        "all of them": (actuator, film),
    }
    unseeing = _changed(real.display.controller, {"observer": None})
    return [
        (
            _try(name, _with(real, actuator=stepper, film=table, controller=unseeing)),
            _try(name, _with(real, actuator=stepper, film=table)),
        )
        for name, (stepper, table) in benches.items()
    ]


def mistakes() -> list[StepperTrial]:
    """The real bench when the controller is wrong about it."""
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
    return [_try(name, real, _changed(stepper, changes)) for name, changes in wrong.items()]


def other_benches() -> list[StepperTrial]:
    """Other films, leads and loop rates than the shipped scenes have."""
    clean, real = clean_bench(), real_bench()
    film = real.display.film
    leads = [
        _try(f"clean, lead {lead_mm} mm", _with(clean, actuator=_lead(clean, lead_mm)))
        for lead_mm in (1, 2, 6)
    ]
    rates = [_try(f"real, {rate_hz} Hz loop", _at_rate(real, rate_hz)) for rate_hz in (500, 200)]
    films: dict[str, dict[str, object]] = {
        "real, film by eq 21: 5305 mV/N": {"sensitivity_v_per_n": None, "adc_range_v": 15.0},
        "real, filter of two poles": {"filter_order": 2},
        "real, filter at 20 Hz": {"filter_hz": 20.0},
    }
    trials = [_try(name, _with(real, film=_changed(film, of))) for name, of in films.items()]
    return [*leads, *rates, *trials]


def tracking() -> tuple[ExperimentRun, ExperimentRun]:
    """The real bench on the film's reading alone, and as shipped."""
    real = real_bench()
    unseeing = _changed(real.display.controller, {"observer": None, "feed_forward": False})
    return experiment.run(_with(real, controller=unseeing)), experiment.run(real)


def _try(name: str, scene: Scene, actual: StepperScene | None = None) -> StepperTrial:
    try:
        return StepperTrial(name, experiment.run(scene, actual).force_rmse_n)
    except SceneError as error:
        return StepperTrial(name, None, str(error))


def _with(scene: Scene, **parts_of_display: Section) -> Scene:
    return replace(scene, display=_changed(scene.display, parts_of_display))


def _changed(section: SectionT, changes: Mapping[str, object]) -> SectionT:
    return section.model_copy(update=dict(changes))


def _stepper(scene: Scene) -> StepperScene:
    actuator = scene.display.actuator
    if not isinstance(actuator, StepperScene):
        raise SceneError(f"{scene.path}: [display] actuator: a stepper is needed here")
    return actuator


def _lead(scene: Scene, lead_mm: int) -> StepperScene:
    return _changed(_stepper(scene), {"lead_m": lead_mm * 1e-3})


def _at_rate(scene: Scene, rate_hz: int) -> Scene:
    """The scene with its loop, and its pulse's samples, at another rate."""
    source = _changed(scene.sensing.source, {"rate_hz": float(rate_hz)})
    sensing = _changed(scene.sensing, {"source": source})
    display = _changed(scene.display, {"tick_ns": round(1e9 / rate_hz)})
    return replace(scene, sensing=sensing, display=display)
