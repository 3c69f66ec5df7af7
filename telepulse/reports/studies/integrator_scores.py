"""Errors and costs of the integrators: on the paper's loop, and on a rotor with a resonance.

Errors are against the exact zero-order hold in 40 decimal digits; costs are processor time.
"""

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import partial

from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError
from sensing_node.scene import SensingScene
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.reports.studies.integrators import (
    PAPER_PLANT,
    Plant,
    Solver,
    Step,
    close_loop,
    control_steps,
    decimal_pid,
    decimal_plant,
    decimals,
    exact_hold,
    explicit_euler,
    lsim_steps,
    lsim_whole,
    open_loop,
    paper_pid,
    pulse_from_rest,
    rk4,
    semi_implicit_euler,
    shipped,
    solve_ivp_steps,
)

LEAST_RUN_S = 2e-3
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
class IntegratorPoint:
    """An integrator at one setting: its error over the pulse's peak to peak, its µs a step.

    Points of one family are one line of the plot.
    """

    family: str
    name: str
    error: float
    cost_us: float
    library: bool = False


def costs_us(
    makes: Sequence[Callable[[], Step[float]]], voltages: Sequence[float], rounds: int
) -> list[float]:
    """Return the median cost of a step of each stepper in µs of processor time.

    The steppers take turns with the same voltages, so that a busy moment of the machine affects
    all alike. Making a stepper is not in its cost.
    """
    costs: list[list[float]] = [[] for _ in makes]
    for _ in range(rounds):
        for make, taken in zip(makes, costs, strict=True):
            taken.append(_cost_us(make(), voltages))
    return [statistics.median(taken) for taken in costs]


def _cost_us(step: Step[float], voltages: Sequence[float]) -> float:
    # The processor's time: other work on the machine is not in it.
    runs, elapsed_s, began_s = 0, 0.0, time.process_time()
    while elapsed_s < LEAST_RUN_S:
        for volts in voltages:
            step(volts)
        runs += 1
        elapsed_s = time.process_time() - began_s
    return elapsed_s / runs / len(voltages) * 1e6


@dataclass(frozen=True, slots=True)
class IntegratorEffort:
    """Amount of computing. The defaults are the study's; tests use less."""

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
    """Results on the paper's loop: a point a method, and the error of the reference.

    Errors are over the pulse's peak to peak. digits_error compares the reference with the same
    in more digits, method_error with RK4 in as many digits. whole_us is the cost in µs a tick of
    one lsim call for all the voltages, without a loop.
    """

    points: list[IntegratorPoint]
    digits_error: float
    method_error: float
    whole_us: float


@dataclass(frozen=True, slots=True)
class IntegratorScores:
    """The loop's scores, and the rotors' errors by damping, method and tick."""

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
    return IntegratorScores(score_loop(PAPER_PLANT, scene, effort, tested), rotors, has_control())


def _pulse_scene() -> SyntheticScene:
    path = find_scene("paper")
    source = load_section(path, "sensing", SensingScene).source
    if not isinstance(source, SyntheticScene):
        raise SceneError(f"{path}: [sensing.source]: this study needs a synthetic pulse")
    return source


def has_control() -> bool:
    """Return whether python-control can be imported."""
    try:
        import control  # noqa: F401
    except ImportError:
        return False
    return True


def methods(substeps: Sequence[int], solvers: Sequence[tuple[Solver, float]]) -> list[Method]:
    """Return the default first, then the others; python-control's only where it is installed.

    `substeps` are those of the written-out methods in a tick, `solvers` the methods of solve_ivp
    and their rtol.
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
    beat_voltages = [float(volts) for volts in voltages[: round(BEAT_S / TICK_S)]]
    makes = [partial(method.make, plant, TICK_S) for method in tested]
    costs = costs_us(makes, beat_voltages, effort.rounds)
    points = []
    for method, make, cost_us in zip(tested, makes, costs, strict=True):
        forces_n, _ = close_loop(make(), paper_pid(TICK_S), pulse_n)
        error = largest_error(decimals(forces_n), truth_n) / peak_to_peak_n
        points.append(IntegratorPoint(method.family, method.name, error, cost_us, method.library))
    return LoopScores(
        points,
        largest_error(more_n, truth_n) / peak_to_peak_n,
        largest_error(other_n, truth_n) / peak_to_peak_n,
        _whole_us(plant, [float(volts) for volts in voltages]),
    )


def score_rotor(
    method: Method, damping: float, scene: SyntheticScene, effort: IntegratorEffort
) -> list[float]:
    """Return the errors over peak to peak, one a tick, of a resonant rotor driven by the pulse.

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
            truth_n = open_loop(true_step, decimals(voltages))
        forces_n = open_loop(method.make(plant, tick_s), voltages)
        errors.append(largest_error(decimals(forces_n), truth_n) / scene.peak_to_peak_n)
    return errors


def largest_error(forces_n: Sequence[Decimal], truth_n: Sequence[Decimal]) -> float:
    """Return the largest difference in N; infinite where a trajectory overflowed."""
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
