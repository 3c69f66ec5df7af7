"""Integration methods for the paper's actuator in its loop and on rotors: error and cost of a step.

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

from benchmarks.benchmark import Benchmark
from benchmarks.integrators import steppers
from benchmarks.integrators.steppers import PAPER_PLANT, Plant, Solver, decimals
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from sensing_node.scene import SensingScene
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.paper.explicit_loop import Step, close_loop
from telepulse.parallel import in_one_thread

LEAST_RUN_S = 2e-3
DEFAULT = "exact zero-order hold (shipped)"
# Methods that are written out here; all others but the default call a library.
WRITTEN_OUT = {
    "RK4": steppers.rk4,
    "semi-implicit Euler": steppers.semi_implicit_euler,
    "explicit Euler": steppers.explicit_euler,
}
TICK_S = 1e-3
BEAT_S = 0.8
DIGITS, MORE_DIGITS = 40, 60
CHECK_SUBSTEPS = 16
ROTOR_HZ = 100.0
ROTOR_DAMPING = (0.001, 0.2)
ROTOR_TICKS_S = (1e-4, 1e-3, 1e-2)
# Errors below this are rounding and count as equal.
ROUNDING = 1e-14
# A trajectory further from the reference than this many times the pulse has diverged.
GROWN = 10.0


@dataclass(frozen=True, slots=True)
class Effort:
    """Amount of computing."""

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


QUICK = Effort(seconds=0.1, rounds=1, substeps=(1,), solvers=(("RK45", 1e-6),), rotor_seconds=0.05)


# Makes a stepper of a plant at a tick in s.
Make = Callable[[Plant[float], float], Step[float]]


class Point(NamedTuple):
    """A method's error over the pulse's peak to peak, and its µs a step."""

    name: str
    error: float
    cost_us: float


class Scores(NamedTuple):
    """One point for each method on the paper's loop; rotors' errors by damping, method and tick.

    Errors are over the pulse's peak to peak. digits_error compares the loop's reference with the
    same in more digits, method_error with RK4.
    """

    points: list[Point]
    digits_error: float
    method_error: float
    rotors: dict[float, dict[str, list[float]]]


def main(benchmark: Benchmark) -> None:
    """Score every method, print the tables, and judge the display node's own."""
    scores = in_one_thread(score_integrators, QUICK if benchmark.quick else Effort())
    default = scores.points[0]
    rows = [
        (
            point.name,
            f"{point.error:.1e}",
            f"{point.cost_us:.2f}",
            f"{point.cost_us / default.cost_us:.1f}",
            "" if beaten_by(point, scores.points) else "yes",
        )
        for point in scores.points
    ]
    benchmark.table(
        f"The paper's loop at a tick of {TICK_S * 1e3:g} ms",
        ("method × sub-steps", "error", "µs a step", "× default", "frontier"),
        rows,
        "Error: largest difference of force, over the pulse's peak to peak. On the frontier: no"
        f" other row is as accurate and as fast, errors below {ROUNDING:g} being equal.",
    )
    for damping, errors in scores.rotors.items():
        benchmark.table(
            f"Error on a rotor that resonates at {ROTOR_HZ:g} Hz with ζ = {damping:g}, by the tick",
            ("method × sub-steps", *(f"{tick_s * 1e3:g} ms" for tick_s in ROTOR_TICKS_S)),
            [
                (name, *("grows" if each > GROWN else f"{each:.1e}" for each in by_tick))
                for name, by_tick in errors.items()
            ],
        )
    checks = (scores.digits_error, scores.method_error)
    reference = f"{DIGITS} digits against {MORE_DIGITS} digits", f"{DIGITS} digits against RK4"
    benchmark.table(
        "Error of the reference",
        ("reference", "difference"),
        [(name, f"{error:.1e}") for name, error in zip(reference, checks, strict=True)],
    )
    benchmark.judge("methods that beat the default", len(beaten_by(default, scores.points)))
    benchmark.judge("error of the default in the loop", default.error)
    benchmark.judge(
        "error of the default on a rotor",
        max(max(each[DEFAULT]) for each in scores.rotors.values()),
    )
    benchmark.judge("error of the reference", max(checks))


def score_integrators(effort: Effort) -> Scores:
    """Score every integrator on the paper's loop and on the rotors. Raises SceneError."""
    path = find_scene("paper")
    source = load_section(path, "sensing", SensingScene).source
    scene = SyntheticScene.narrow(source, f"{path}: [sensing] source:")
    pulse_n, plant = steppers.pulse_from_rest(scene, effort.seconds, TICK_S), PAPER_PLANT

    def true_loop(
        make: Callable[[], Step[Decimal]], digits: int
    ) -> tuple[list[Decimal], list[Decimal]]:
        with localcontext(prec=digits):
            return close_loop(make(), TICK_S, decimals(pulse_n))

    hold = partial(steppers.exact_hold, plant, TICK_S)
    rk4 = partial(steppers.rk4, Plant(*decimals(plant)), Decimal(TICK_S), CHECK_SUBSTEPS)
    truth_n, true_voltages = true_loop(hold, DIGITS)
    more_n, _ = true_loop(hold, MORE_DIGITS)
    other_n, _ = true_loop(rk4, DIGITS)
    voltages = [float(volts) for volts in true_voltages]
    tested = methods(effort.substeps, effort.solvers)
    makes = [partial(make, plant, TICK_S) for make in tested.values()]
    costs = costs_us(makes, voltages[: round(BEAT_S / TICK_S)], effort.rounds)
    points = []
    for name, make, cost_us in zip(tested, makes, costs, strict=True):
        forces_n, _ = close_loop(make(), TICK_S, pulse_n)
        error = steppers.largest_error(decimals(forces_n), truth_n) / scene.peak_to_peak_n
        points.append(Point(name, error, cost_us))
    on_rotor = methods(substeps=(1,), solvers=(("RK45", 1e-6),))
    return Scores(
        points,
        steppers.largest_error(more_n, truth_n) / scene.peak_to_peak_n,
        steppers.largest_error(other_n, truth_n) / scene.peak_to_peak_n,
        {
            damping: {
                name: score_rotor(make, damping, scene, effort) for name, make in on_rotor.items()
            }
            for damping in ROTOR_DAMPING
        },
    )


def methods(substeps: Sequence[int], solvers: Sequence[tuple[Solver, float]]) -> dict[str, Make]:
    """Return the default method, then the others; python-control's only where it is installed.

    substeps: sub-steps in a tick, of the written-out methods. solvers: of solve_ivp, with rtol.
    """
    found: dict[str, Make] = {DEFAULT: steppers.shipped}
    for family, stepper in WRITTEN_OUT.items():
        for count in substeps:
            found[f"{family} × {count}"] = partial(stepper, substeps=count)
    for solver, rtol in solvers:
        steps = partial(steppers.solve_ivp_steps, method=solver, rtol=rtol)
        found[f"solve_ivp {solver} rtol {rtol:.0e}"] = steps
    found["scipy lsim"] = steppers.lsim_steps
    if find_spec("control") is not None:
        found["python-control forced_response"] = steppers.control_steps
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


def score_rotor(make: Make, damping: float, scene: SyntheticScene, effort: Effort) -> list[float]:
    """Return the errors over peak to peak of a resonant rotor driven by the pulse, by tick length.

    m = 1, 100 Hz; the voltage is k times the pulse, without a controller, which could stabilise
    the rotor.
    """
    omega = 2 * math.pi * ROTOR_HZ
    plant = Plant(1.0, 2 * damping * omega, omega**2)
    errors = []
    for tick_s in ROTOR_TICKS_S:
        pulse_n = steppers.pulse_from_rest(scene, effort.rotor_seconds, tick_s)
        voltages = [plant.k * force_n for force_n in pulse_n]
        with localcontext(prec=DIGITS):
            true_step = steppers.exact_hold(plant, tick_s)
            truth_n = [true_step(volts) for volts in decimals(voltages)]
        step = make(plant, tick_s)
        forces_n = [step(volts) for volts in voltages]
        errors.append(steppers.largest_error(decimals(forces_n), truth_n) / scene.peak_to_peak_n)
    return errors


def beaten_by(point: Point, points: Sequence[Point]) -> list[Point]:
    """Return the points that are at least as accurate and as fast, and better in one of the two."""

    def figures(of: Point) -> tuple[float, float]:
        return max(of.error, ROUNDING), of.cost_us

    error, cost_us = figures(point)
    return [
        other
        for other in points
        if figures(other) != (error, cost_us)
        and figures(other)[0] <= error
        and figures(other)[1] <= cost_us
    ]
