"""Scores of the study of integrators, on the paper's loop and on a rotor with a resonance.

Errors are against the exact zero-order hold in 40 decimal digits; costs are processor time.
"""

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import partial
from importlib.util import find_spec
from typing import NamedTuple

from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from sensing_node.scene import SensingScene
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.paper.explicit_loop import Step, close_loop
from telepulse.reports.studies import integrators
from telepulse.reports.studies.integrators import PAPER_PLANT, Plant, Solver, decimals

LEAST_RUN_S = 2e-3
LSIM = "scipy lsim"
CONTROL = "python-control forced_response"
DEFAULT = "exact zero-order hold (shipped)"
# Methods that are written out here; all others but the default call a library.
WRITTEN_OUT = {
    "RK4": integrators.rk4,
    "semi-implicit Euler": integrators.semi_implicit_euler,
    "explicit Euler": integrators.explicit_euler,
}
TICK_S = 1e-3
BEAT_S = 0.8
DIGITS, MORE_DIGITS = 40, 60
CHECK_SUBSTEPS = 16
ROTOR_HZ = 100.0
ROTOR_DAMPING = (0.001, 0.2)
ROTOR_TICKS_S = (1e-4, 1e-3, 1e-2)


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


class Method(NamedTuple):
    """An integrator at one setting, for any plant and tick in s; a family is a line of the plot."""

    family: str
    name: str
    make: Callable[[Plant[float], float], Step[float]]


class IntegratorPoint(NamedTuple):
    """A method's error over the pulse's peak to peak, and its µs a step."""

    family: str
    name: str
    error: float
    cost_us: float


class IntegratorScores(NamedTuple):
    """One point for each method on the paper's loop; rotors' errors by damping, method and tick.

    Errors are over the pulse's peak to peak. digits_error compares the loop's reference with the
    same in more digits, method_error with RK4. whole_us is the cost in µs per tick of one lsim
    call for all voltages, without a loop.
    """

    points: list[IntegratorPoint]
    digits_error: float
    method_error: float
    whole_us: float
    rotors: dict[float, dict[str, list[float]]]


def score_integrators(effort: IntegratorEffort) -> IntegratorScores:
    """Score every integrator on the paper's loop and on the rotors. Raises SceneError."""
    path = find_scene("paper")
    source = load_section(path, "sensing", SensingScene).source
    scene = SyntheticScene.narrow(source, f"{path}: [sensing] source:")
    pulse_n, plant = integrators.pulse_from_rest(scene, effort.seconds, TICK_S), PAPER_PLANT

    def true_loop(
        make: Callable[[], Step[Decimal]], digits: int
    ) -> tuple[list[Decimal], list[Decimal]]:
        with localcontext(prec=digits):
            return close_loop(make(), TICK_S, decimals(pulse_n))

    hold = partial(integrators.exact_hold, plant, TICK_S)
    rk4 = partial(integrators.rk4, Plant(*decimals(plant)), Decimal(TICK_S), CHECK_SUBSTEPS)
    truth_n, true_voltages = true_loop(hold, DIGITS)
    more_n, _ = true_loop(hold, MORE_DIGITS)
    other_n, _ = true_loop(rk4, DIGITS)
    voltages = [float(volts) for volts in true_voltages]
    tested = methods(effort.substeps, effort.solvers)
    makes = [partial(method.make, plant, TICK_S) for method in tested]
    costs = costs_us(makes, voltages[: round(BEAT_S / TICK_S)], effort.rounds)
    points = []
    for method, make, cost_us in zip(tested, makes, costs, strict=True):
        forces_n, _ = close_loop(make(), TICK_S, pulse_n)
        error = integrators.largest_error(decimals(forces_n), truth_n) / scene.peak_to_peak_n
        points.append(IntegratorPoint(method.family, method.name, error, cost_us))
    began_s = time.process_time()
    integrators.lsim_whole(plant, TICK_S, voltages)
    whole_us = (time.process_time() - began_s) / len(voltages) * 1e6
    on_rotor = methods(substeps=(1,), solvers=(("RK45", 1e-6),))
    return IntegratorScores(
        points,
        integrators.largest_error(more_n, truth_n) / scene.peak_to_peak_n,
        integrators.largest_error(other_n, truth_n) / scene.peak_to_peak_n,
        whole_us,
        {
            damping: {each.name: score_rotor(each, damping, scene, effort) for each in on_rotor}
            for damping in ROTOR_DAMPING
        },
    )


def methods(substeps: Sequence[int], solvers: Sequence[tuple[Solver, float]]) -> list[Method]:
    """Return the default method, then the others; python-control's only where it is installed.

    substeps: sub-steps in a tick, of the written-out methods. solvers: of solve_ivp, with rtol.
    """
    found = [Method(DEFAULT, DEFAULT, integrators.shipped)]
    for family, stepper in WRITTEN_OUT.items():
        for count in substeps:
            found.append(Method(family, f"{family} × {count}", partial(stepper, substeps=count)))
    for solver, rtol in solvers:
        steps = partial(integrators.solve_ivp_steps, method=solver, rtol=rtol)
        family = f"solve_ivp {solver}"
        found.append(Method(family, f"{family} rtol {rtol:.0e}", steps))
    found.append(Method(LSIM, LSIM, integrators.lsim_steps))
    if find_spec("control") is not None:
        found.append(Method(CONTROL, CONTROL, integrators.control_steps))
    return found


def costs_us(
    makes: Sequence[Callable[[], Step[float]]], voltages: Sequence[float], rounds: int
) -> list[float]:
    """Return the median cost of a step of each stepper in µs of processor time.

    The steppers take turns with the same voltages, so that a busy moment of the machine affects
    all equally. The cost does not include making a stepper.
    """
    costs: list[list[float]] = [[] for _ in makes]
    for _ in range(rounds):
        for make, taken_us in zip(makes, costs, strict=True):
            step = make()
            # Processor time, which excludes other work on the machine.
            runs, elapsed_s, began_s = 0, 0.0, time.process_time()
            while elapsed_s < LEAST_RUN_S:
                for volts in voltages:
                    step(volts)
                runs += 1
                elapsed_s = time.process_time() - began_s
            taken_us.append(elapsed_s / runs / len(voltages) * 1e6)
    return [statistics.median(taken_us) for taken_us in costs]


def score_rotor(
    method: Method, damping: float, scene: SyntheticScene, effort: IntegratorEffort
) -> list[float]:
    """Return the errors over peak to peak of a resonant rotor driven by the pulse, by tick length.

    m = 1, 100 Hz; the voltage is k times the pulse, without a controller, which could stabilise
    the rotor.
    """
    omega = 2 * math.pi * ROTOR_HZ
    plant = Plant(1.0, 2 * damping * omega, omega**2)
    errors = []
    for tick_s in ROTOR_TICKS_S:
        pulse_n = integrators.pulse_from_rest(scene, effort.rotor_seconds, tick_s)
        voltages = [plant.k * force_n for force_n in pulse_n]
        with localcontext(prec=DIGITS):
            true_step = integrators.exact_hold(plant, tick_s)
            truth_n = [true_step(volts) for volts in decimals(voltages)]
        step = method.make(plant, tick_s)
        forces_n = [step(volts) for volts in voltages]
        errors.append(integrators.largest_error(decimals(forces_n), truth_n) / scene.peak_to_peak_n)
    return errors
