"""Errors and costs of the integrators: on the paper's loop, and on a rotor with a resonance."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import partial

from display_node.plant.second_order import SecondOrderScene
from protocol.config.scene import load_section
from protocol.errors import SceneError
from sensing_node.scene import SensingScene
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.reports.studies.integrator_loop import (
    close_loop,
    decimal_pid,
    decimal_plant,
    decimals,
    hold_open,
    paper_pid,
    pulse_from_rest,
)
from telepulse.reports.studies.integrators import (
    Plant,
    Step,
    exact_hold,
    explicit_euler,
    rk4,
    semi_implicit_euler,
    shipped,
)
from telepulse.reports.studies.library_integrators import (
    Solver,
    control_steps,
    lsim_steps,
    lsim_whole,
    solve_ivp_steps,
)
from telepulse.reports.studies.work_precision import Point, costs_us
from telepulse.scene import find_scene

LSIM = "scipy lsim"
CONTROL = "python-control forced_response"
DEFAULT = "exact zero-order hold (shipped)"
TICK_S = 1e-3
BEAT_S = 0.8
DIGITS, MORE_DIGITS = 40, 60
CHECK_SUBSTEPS = 16
ROTOR_HZ = 100.0
ROTOR_DAMPING = (0.001, 0.2)
ROTOR_TICKS_S = (1e-4, 1e-3, 1e-2)


@dataclass(frozen=True, slots=True)
class IntegratorEffort:
    """How much to compute. The defaults are the study's; tests do with less."""

    seconds: float = 6.0
    rounds: int = 9
    substeps: tuple[int, ...] = (1, 2, 4, 8, 16)
    solvers: tuple[tuple[Solver, float], ...] = (
        ("RK45", 1e-3),
        ("RK45", 1e-6),
        ("RK45", 1e-9),
        ("DOP853", 1e-3),
        ("Radau", 1e-3),
    )
    rotor_seconds: float = BEAT_S


@dataclass(frozen=True, slots=True)
class Method:
    """An integrator at one setting, for any plant and tick in s."""

    family: str
    name: str
    make: Callable[[Plant[float], float], Step[float]]
    library: bool = False


@dataclass(frozen=True, slots=True)
class LoopScores:
    """What the paper's loop gave: a point a method, and how sure the reference is.

    Errors are over the pulse's peak to peak. digits_error: the reference against the same in
    more digits; method_error: against RK4 in as many digits. whole_us: µs a tick of one lsim
    call for all the voltages, with no loop.
    """

    points: list[Point]
    digits_error: float
    method_error: float
    whole_us: float


@dataclass(frozen=True, slots=True)
class IntegratorScores:
    """The loop's scores, and a rotor's errors by its damping: a row a method, a column a tick."""

    loop: LoopScores
    rotors: dict[float, dict[str, list[float]]]
    has_control: bool


def score_integrators(effort: IntegratorEffort) -> IntegratorScores:
    """Score every integrator on both. Raises SceneError."""
    scene = _pulse_scene()
    on_rotor = methods(substeps=(1,), solvers=(("RK45", 1e-6),))
    rotors = {
        damping: {method.name: score_rotor(method, damping, scene, effort) for method in on_rotor}
        for damping in ROTOR_DAMPING
    }
    tested = methods(effort.substeps, effort.solvers)
    return IntegratorScores(score_loop(table_4(), scene, effort, tested), rotors, has_control())


def table_4() -> Plant[float]:
    """The paper's actuator."""
    scene = SecondOrderScene(kind="second_order")
    return Plant(scene.m, scene.c, scene.k)


def _pulse_scene() -> SyntheticScene:
    path = find_scene("paper")
    source = load_section(path, "sensing", SensingScene).source
    if not isinstance(source, SyntheticScene):
        raise SceneError(f"{path}: [sensing.source]: this study needs a synthetic pulse")
    return source


def has_control() -> bool:
    """Whether python-control can be imported."""
    try:
        import control  # noqa: F401
    except ImportError:
        return False
    return True


def methods(substeps: Sequence[int], solvers: Sequence[tuple[Solver, float]]) -> list[Method]:
    """The default first, then the others; python-control's only where it is installed.

    substeps: of the written-out methods, a tick; solvers: solve_ivp's methods and their rtol.
    """
    found = [Method(DEFAULT, DEFAULT, shipped)]
    found += [_fixed("RK4", rk4, count) for count in substeps]
    found += [_fixed("semi-implicit Euler", semi_implicit_euler, count) for count in substeps]
    found += [_fixed("explicit Euler", explicit_euler, count) for count in substeps]
    found += [_adaptive(solver, rtol) for solver, rtol in solvers]
    found.append(Method(LSIM, LSIM, lsim_steps, library=True))
    if has_control():
        found.append(Method(CONTROL, CONTROL, control_steps, library=True))
    return found


def _fixed(
    family: str, stepper: Callable[[Plant[float], float, int], Step[float]], substeps: int
) -> Method:
    return Method(
        family, f"{family} × {substeps}", lambda plant, tick_s: stepper(plant, tick_s, substeps)
    )


def _adaptive(solver: Solver, rtol: float) -> Method:
    family = f"solve_ivp {solver}"
    return Method(
        family,
        f"{family} rtol {rtol:.0e}",
        lambda plant, tick_s: solve_ivp_steps(plant, tick_s, solver, rtol),
        library=True,
    )


def score_loop(
    plant: Plant[float], scene: SyntheticScene, effort: IntegratorEffort, tested: Sequence[Method]
) -> LoopScores:
    """Close the paper's loop with every method, and time each on the voltages of the loop."""
    pulse_n = pulse_from_rest(scene, effort.seconds, TICK_S)
    peak_to_peak_n = scene.peak_to_peak_n
    truth_n, voltages = _true_loop(exact_hold, plant, pulse_n, DIGITS)
    more_n, _ = _true_loop(exact_hold, plant, pulse_n, MORE_DIGITS)
    other_n, _ = _true_loop(_fine_rk4, plant, pulse_n, DIGITS)
    played = [float(volts) for volts in voltages[: round(BEAT_S / TICK_S)]]
    makes = [partial(method.make, plant, TICK_S) for method in tested]
    costs = costs_us(makes, played, effort.rounds)
    points = []
    for method, make, cost_us in zip(tested, makes, costs, strict=True):
        forces_n, _ = close_loop(make(), paper_pid(TICK_S), pulse_n)
        error = largest_error(decimals(forces_n), truth_n) / peak_to_peak_n
        points.append(Point(method.family, method.name, error, cost_us, method.library))
    return LoopScores(
        points,
        largest_error(more_n, truth_n) / peak_to_peak_n,
        largest_error(other_n, truth_n) / peak_to_peak_n,
        _whole_us(plant, [float(volts) for volts in voltages]),
    )


def score_rotor(
    method: Method, damping: float, scene: SyntheticScene, effort: IntegratorEffort
) -> list[float]:
    """Errors over peak to peak, a tick each, of a resonant rotor told to follow the pulse.

    m = 1, 100 Hz, the voltage k times the pulse: a controller would add a stability of its own.
    """
    omega = 2 * math.pi * ROTOR_HZ
    plant = Plant(1.0, 2 * damping * omega, omega**2)
    errors = []
    for tick_s in ROTOR_TICKS_S:
        pulse_n = pulse_from_rest(scene, effort.rotor_seconds, tick_s)
        voltages = [plant.k * force_n for force_n in pulse_n]
        with localcontext(prec=DIGITS):
            true_step = exact_hold(decimal_plant(plant), Decimal(tick_s))
            truth_n = hold_open(true_step, decimals(voltages))
        forces_n = hold_open(method.make(plant, tick_s), voltages)
        errors.append(largest_error(decimals(forces_n), truth_n) / scene.peak_to_peak_n)
    return errors


def largest_error(forces_n: Sequence[Decimal], truth_n: Sequence[Decimal]) -> float:
    """The largest difference in N; infinite where a trajectory left the range of floats."""
    if not all(force_n.is_finite() for force_n in forces_n):
        return math.inf
    return float(max(abs(a - b) for a, b in zip(forces_n, truth_n, strict=True)))


def _true_loop(
    stepper: Callable[[Plant[Decimal], Decimal], Step[Decimal]],
    plant: Plant[float],
    pulse_n: Sequence[float],
    digits: int,
) -> tuple[list[Decimal], list[Decimal]]:
    with localcontext(prec=digits):
        step = stepper(decimal_plant(plant), Decimal(TICK_S))
        return close_loop(step, decimal_pid(paper_pid(TICK_S)), decimals(pulse_n))


def _fine_rk4(plant: Plant[Decimal], tick_s: Decimal) -> Step[Decimal]:
    return rk4(plant, tick_s, CHECK_SUBSTEPS)


def _whole_us(plant: Plant[float], voltages: Sequence[float]) -> float:
    began_s = time.process_time()
    lsim_whole(plant, TICK_S, voltages)
    return (time.process_time() - began_s) / len(voltages) * 1e6
