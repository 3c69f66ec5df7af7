"""Design of a force loop's gains, with their margins.

For a stepper, the observer's gains are those of a stationary Kalman filter (a Riccati equation).
kp minimises the felt force of a wandering finger and a noisy film, by a bounded search within the
margins below. For the paper's actuator, the PID gains place the three poles of the continuous
loop, as fast as the same margins allow.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from display_node.control.linear_loop import (
    FORCE_SHARES,
    LinearLoop,
    Margins,
    felt_noise,
    linear_loop,
    margins,
)
from display_node.control.observer import DESIGN_FORCE_N
from display_node.control.scene import ControllerScene, ObserverScene
from display_node.plant.scene import SecondOrderScene, StepperScene
from display_node.scene import DisplayScene
from telepulse.document import Chapter, Report, Table

# Margins that a designed loop keeps: the Nyquist curve stays 1/1.4 from −1 (a gain margin of
# at least 3.5 and a phase margin of at least 42°), and the drive may answer 5 ticks late.
MOST_SENSITIVITY = 1.4
LEAST_DELAY_TICKS = 5
# Wander of a finger under the tip in 1 s, for a scene without `wander`.
WANDER_M = 2e-5
KP_RANGE = (1.0, 2_000.0)
BISECTIONS = 20
PLACED_DAMPING = 0.8


@dataclass(frozen=True, slots=True)
class Design:
    """A controller and the figures of its loop.

    worst: the worst margins from light touch to the force limit. felt_n: RMS felt force of wander
    and noise in N; None where the model has no finger.
    """

    controller: ControllerScene
    worst: Margins
    felt_n: float | None


_ROWS: dict[str, Callable[[Design], str]] = {
    "kp": lambda design: f"{design.controller.kp:g}",
    "ki": lambda design: f"{design.controller.ki:g}",
    "kd": lambda design: f"{design.controller.kd:g}",
    "dead band": lambda design: f"{design.controller.dead_band:g}",
    "observer": lambda design: "yes" if design.controller.observer is not None else "no",
    "stable": lambda design: "yes" if design.worst.stable else "no",
    "largest pole": lambda design: f"{design.worst.pole_radius:.6f}",
    "gain margin": lambda design: f"{design.worst.gain:.3g}",
    "phase margin": lambda design: f"{design.worst.phase_deg:.0f}°",
    "delay margin": lambda design: f"{design.worst.delay_s * 1e3:.3g} ms",
    "peak sensitivity Ms": lambda design: f"{design.worst.peak_sensitivity:.3f}",
    "felt force by wander and noise": lambda design: (
        "–" if design.felt_n is None else f"{design.felt_n * 1e3:.2f} mN RMS"
    ),
}


def judge(scene: DisplayScene, controller: ControllerScene) -> Design:
    """Return a controller's margins in a scene, the worst over the range of forces."""
    limit_n = scene.safety.force_limit_n
    every = [margins(_loop(scene, controller, share * limit_n)) for share in FORCE_SHARES]
    worst = Margins(
        pole_radius=max(each.pole_radius for each in every),
        gain=min(each.gain for each in every),
        phase_deg=min(each.phase_deg for each in every),
        delay_s=min(each.delay_s for each in every),
        peak_sensitivity=max(each.peak_sensitivity for each in every),
    )
    felt_n = None
    if worst.stable and (stepper := scene.actuator.stepper) is not None:
        felt_n = _felt_n(scene, stepper, controller)
    return Design(controller, worst, felt_n)


def design(scene: DisplayScene) -> Design:
    """Return the designed controller for a scene's actuator and film. Raises SceneError."""
    if (stepper := scene.actuator.stepper) is not None:
        return _design_stepper(scene, stepper)
    model = SecondOrderScene.narrow(scene.actuator, "[display] actuator: to design gains,")
    return _design_second_order(scene, model)


def report_design(name: str, present: Design, proposed: Design) -> Report:
    """Return the margins of the scene's controller and of the proposed one."""
    rows = tuple((label, of(present), of(proposed)) for label, of in _ROWS.items())
    table = Table(
        f"force loop of {name}",
        ("", "scene", "design"),
        rows,
        note="margins: the worst of light touch, a pulse's usual mean force and the force limit",
    )
    return Report(f"Force loop of {name}", (Chapter("Margins", tables=(table,)),))


def as_toml(controller: ControllerScene) -> str:
    """Return the controller's table in TOML, with each key that a parent scene may set."""
    lines = ["[display.controller]", f'error = "{controller.error}"']
    lines.append(f"feed_forward = {str(controller.feed_forward).lower()}")
    lines += [f"{name} = {getattr(controller, name):g}" for name in ("kp", "ki", "kd")]
    if controller.kd:
        lines.append(f'derivative_filter = "{controller.derivative_filter_hz:g} Hz"')
    lines.append(f"dead_band = {controller.dead_band:g}")
    if controller.observer is not None:
        observer = controller.observer
        lines += ["", "[display.controller.observer]"]
        lines.append(f'wander = "{observer.wander_m * 1e6:g} µm"')
        lines.append(f"softening = {observer.softening:g}")
    return "\n".join(lines)


def _design_stepper(scene: DisplayScene, actuator: StepperScene) -> Design:
    from scipy.optimize import minimize_scalar

    modelled = scene.film.filter_hz is not None or actuator.rotor_resonance_hz is not None
    observer = scene.controller.observer
    if observer is None and modelled:
        observer = ObserverScene.model_validate({"wander": f"{WANDER_M} m"})
    fixed = {"ki": 0.0, "kd": 0.0, "error": "position", "feed_forward": True, "observer": observer}

    def with_kp(log_kp: float) -> ControllerScene:
        kp = _two_digits(math.exp(log_kp))
        changes = fixed | {"kp": kp, "dead_band": 0.0}
        if observer is None:
            # Without a dead band, a target between two microsteps reverses the motor at every tick.
            changes["dead_band"] = float(f"{1.01 * actuator.step_m / 2:.2g}")
        return scene.controller.model_copy(update=changes)

    lowest, highest = (math.log(kp) for kp in KP_RANGE)
    highest = _most_robust(scene, with_kp, lowest, highest)
    best = minimize_scalar(
        lambda log_kp: _felt_n(scene, actuator, with_kp(log_kp)),
        bounds=(lowest, highest),
        method="bounded",
    )
    return judge(
        scene, min((with_kp(best.x), with_kp(highest)), key=lambda it: _felt_n(scene, actuator, it))
    )


def _design_second_order(scene: DisplayScene, actuator: SecondOrderScene) -> Design:
    per_volt = scene.controller.error_per_newton(scene.film)

    def placed(log_w: float) -> ControllerScene:
        # m s³ + (c + kd) s² + (k + kp) s + ki = m (s + w) (s² + 2 ζ w s + w²)
        w = _two_digits(math.exp(log_w))
        gains = {
            "kd": actuator.m * w * (1 + 2 * PLACED_DAMPING) - actuator.c,
            "kp": actuator.m * w**2 * (1 + 2 * PLACED_DAMPING) - actuator.k,
            "ki": actuator.m * w**3,
        }
        changes = {name: float(f"{gain / per_volt:.3g}") for name, gain in gains.items()}
        filter_hz = _two_digits(10 * w / (2 * math.pi))
        return scene.controller.model_copy(update=changes | {"derivative_filter_hz": filter_hz})

    slowest = 2 * math.sqrt(actuator.k / actuator.m) + actuator.c / actuator.m + 1.0
    fastest = math.log(math.pi / (scene.tick_ns * 1e-9))
    return judge(scene, placed(_most_robust(scene, placed, math.log(slowest), fastest)))


def _most_robust(
    scene: DisplayScene, controller: Callable[[float], ControllerScene], low: float, high: float
) -> float:
    """Return the largest argument in low … high whose loop keeps the margins, by bisection."""
    late_s = LEAST_DELAY_TICKS * scene.tick_ns * 1e-9

    def keeps(at: float) -> bool:
        loop = margins(_loop(scene, controller(at), DESIGN_FORCE_N))
        robust = loop.stable and loop.peak_sensitivity <= MOST_SENSITIVITY
        return robust and loop.delay_s >= late_s

    if keeps(high):
        return high
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return low


def _felt_n(scene: DisplayScene, actuator: StepperScene, controller: ControllerScene) -> float:
    stiffness = actuator.contact(scene.layer.layer()).stiffness(DESIGN_FORCE_N)
    observer = controller.observer
    wander_m = observer.wander_m if observer is not None else WANDER_M
    noise_m = math.hypot(scene.film.noise_with_adc_n / stiffness, actuator.step_m / math.sqrt(12))
    loop = _loop(scene, controller, DESIGN_FORCE_N)
    return stiffness * felt_noise(loop, wander_m, noise_m)


def _loop(scene: DisplayScene, controller: ControllerScene, force_n: float) -> LinearLoop:
    return linear_loop(
        controller, scene.actuator, scene.layer.layer(), scene.film, scene.tick_ns * 1e-9, force_n
    )


def _two_digits(value: float) -> float:
    """Return the next number of two digits towards 0: rounding must not cost margin."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / unit * (1 + 1e-9)) * unit:.2g}")
