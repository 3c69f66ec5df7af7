"""Errors and costs of the integrators: on the paper's loop, and on a rotor with a resonance.

The loop that the study of integrators closes: the paper's pulse, a discrete PID, a stepper.

The PID is written out here, apart from the display's, so that every integrator meets the same
one and so that it also runs in decimals.
"""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import partial
from typing import Generic

import numpy as np

from display_node.plant.second_order import SecondOrderScene
from protocol.config.scene import load_section
from protocol.errors import SceneError
from protocol.tactile import Film
from sensing_node.scene import SensingScene
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.reports.studies.integrators import (
    Number,
    Plant,
    Solver,
    Step,
    control_steps,
    exact_hold,
    explicit_euler,
    held_matrix,
    lsim_steps,
    lsim_whole,
    rk4,
    semi_implicit_euler,
    shipped,
    solve_ivp_steps,
)
from telepulse.reports.studies.work_precision import Point, costs_us
from telepulse.scene import find_scene

# Table 5, the experiment's gains, read as acting on an error in mV by eq 21 at the display's
# film; the derivative's filter is not the paper's but that of our scene.
KP, KI, KD = 15.0, 0.15, 0.03
DERIVATIVE_FILTER_HZ = 200.0
MILLIVOLTS_PER_NEWTON = 1e3 * Film(9e-3).volts_per_newton

Memory = tuple[Number, Number, Number]
"""What the PID keeps: its integral in V, its filtered derivative in V, the last error in N."""


def pulse_from_rest(scene: SyntheticScene, seconds: float, tick_s: float) -> list[float]:
    """A synthetic pulse once a tick, in N above its first sample, so that it begins at rest."""
    source = SyntheticSource(scene.model_copy(update={"rate_hz": 1 / tick_s}))
    force_n = source.take(round(seconds / tick_s))[:, 0]
    risen_n: list[float] = (force_n - force_n[0]).tolist()
    return risen_n


@dataclass(frozen=True, slots=True)
class DiscretePid(Generic[Number]):
    """A discrete PID's gains a tick, from an error in N to a voltage in V."""

    proportional: Number
    integral: Number
    derivative: Number
    keep: Number


def paper_pid(tick_s: float) -> DiscretePid[float]:
    """The experiment's gains; integral, derivative and its filter by backward Euler."""
    filter_s = 1 / (2 * math.pi * DERIVATIVE_FILTER_HZ)
    return DiscretePid(
        KP * MILLIVOLTS_PER_NEWTON,
        KI * MILLIVOLTS_PER_NEWTON * tick_s,
        KD * MILLIVOLTS_PER_NEWTON / (filter_s + tick_s),
        filter_s / (filter_s + tick_s),
    )


def pid_step(
    pid: DiscretePid[Number], memory: Memory[Number], error_n: Number
) -> tuple[Number, Memory[Number]]:
    """One tick of the PID: the voltage, and what it keeps."""
    integral, derivative, last_n = memory
    integral = integral + pid.integral * error_n
    derivative = pid.keep * derivative + pid.derivative * (error_n - last_n)
    volts = pid.proportional * error_n + integral + derivative
    return volts, (integral, derivative, error_n)


def close_loop(
    step: Step[Number], pid: DiscretePid[Number], reference_n: Sequence[Number]
) -> tuple[list[Number], list[Number]]:
    """Follow a reference from rest: the force in N after each tick, the voltage held in it."""
    force_n = reference_n[0] * 0
    memory = (force_n, force_n, force_n)
    forces_n, voltages = [], []
    for wanted_n in reference_n:
        volts, memory = pid_step(pid, memory, wanted_n - force_n)
        force_n = step(volts)
        forces_n.append(force_n)
        voltages.append(volts)
    return forces_n, voltages


def hold_open(step: Step[Number], voltages: Iterable[Number]) -> list[Number]:
    """Without a controller: the force in N after each tick of given voltages."""
    return [step(volts) for volts in voltages]


def decimals(numbers: Iterable[float]) -> list[Decimal]:
    """Floats as decimals, digit for digit."""
    return [Decimal(number) for number in numbers]


def decimal_plant(plant: Plant[float]) -> Plant[Decimal]:
    """A plant as decimals, digit for digit."""
    return Plant(*decimals((plant.m, plant.c, plant.k)))


def decimal_pid(pid: DiscretePid[float]) -> DiscretePid[Decimal]:
    """A PID as decimals, digit for digit."""
    return DiscretePid(*decimals((pid.proportional, pid.integral, pid.derivative, pid.keep)))


def loop_radius(plant: Plant[float], tick_s: float) -> float:
    """Spectral radius of the closed loop's map from tick to tick; below 1 it is stable."""
    with localcontext(prec=40):
        held = held_matrix(decimal_plant(plant), Decimal(tick_s))
    (a11, a12, b1), (a21, a22, b2) = ([float(x) for x in row] for row in held[:2])
    pid, columns = paper_pid(tick_s), []
    # The map is linear: its columns are what becomes of the unit states.
    for force, rate, *memory in np.eye(5).tolist():
        volts, kept = pid_step(pid, (memory[0], memory[1], memory[2]), -force)
        columns.append(
            [a11 * force + a12 * rate + b1 * volts, a21 * force + a22 * rate + b2 * volts, *kept]
        )
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max())


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
