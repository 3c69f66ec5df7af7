"""The study of integrators: errors and costs on the paper's loop, and on a rotor with a resonance.

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
from typing import TYPE_CHECKING, NamedTuple

from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from sensing_node.scene import SensingScene
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.reports.document import STYLES, Chapter, Plot, Report, Table
from telepulse.reports.paper.explicit_loop import Step, close_loop, spectral_radius
from telepulse.reports.paper.published import EXPERIMENT
from telepulse.reports.studies import integrators
from telepulse.reports.studies.integrators import PAPER_PLANT, Plant, Solver, decimals

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_RUN_S = 2e-3
LSIM = "scipy lsim"
CONTROL = "python-control forced_response"
NOT_INSTALLED = "not installed: pip install 'telepulse[bench]'"
DEFAULT = "exact zero-order hold (shipped)"
# Methods that are written out here; all others but the default call a library.
WRITTEN_OUT = {
    "RK4": integrators.rk4,
    "semi-implicit Euler": integrators.semi_implicit_euler,
    "explicit Euler": integrators.explicit_euler,
}
TICK_S = 1e-3
# Corner of the derivative's filter in scenes/paper.toml.
FILTER_RAD_PER_S = 2 * math.pi * 200
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


def report_integrators(scores: IntegratorScores, effort: IntegratorEffort) -> Report:
    """Return the report on scores that took this effort."""
    return Report(
        "Integration methods on the paper's loop: cost per step against error",
        (_loop_chapter(scores, effort), _rotor_chapter(scores, effort)),
    )


def _loop_chapter(scores: IntegratorScores, effort: IntegratorEffort) -> Chapter:
    points, radius = scores.points, spectral_radius(1 / TICK_S, EXPERIMENT, FILTER_RAD_PER_S)
    paragraphs = (
        f"The paper's pulse for {effort.seconds:g} s, the experiment's gains of Table 5 (on the"
        " error in millivolts by eq 21, its derivative filtered), the actuator of eq 22 with"
        f" Table 4. The controller's tick is {TICK_S * 1e3:g} ms and the voltage is held over"
        " it. Integral, derivative and filter are discretised by backward Euler, which leaves"
        f" the closed loop a spectral radius of {radius:.6f}:"
        f" {'stable' if radius < 1 else 'unstable'}.",
        "The pulse is counted from its first sample, so that the loop begins at rest: otherwise"
        " the errors would show only the step at the start. Every integrator steps the"
        " actuator inside the closed loop, with the same controller. Error: largest difference"
        " in force from the reference, over the pulse's peak to peak. Cost: processor time of"
        " the actuator's step alone, without the controller and in one thread, on the voltages"
        f" of the loop's first beat; median of {effort.rounds} rounds taken in turns.",
        "Where all voltages are known beforehand, one call of lsim for the whole run costs"
        f" {scores.whole_us:.2g} µs per tick; a loop cannot be closed that way.",
    )
    caption = (
        "Largest error against cost of a step. The star is the default; libraries are"
        " hollow; in the shaded band, errors are rounding and count as equal."
    )
    plot = Plot("work-precision", caption, lambda figure: _draw(figure, points))
    rows = [
        {
            "integrator": point.name,
            "error": f"{point.error:.1e}",
            "µs a step": f"{point.cost_us:.2f}",
            "× default": f"{point.cost_us / points[0].cost_us:.1f}",
            "frontier": "" if beaten_by(point, points) else "yes",
        }
        for point in points
    ]
    if CONTROL not in {point.name for point in points}:
        rows.append(dict.fromkeys(rows[0], "") | {"integrator": f"{CONTROL}: {NOT_INSTALLED}"})
    note = (
        f"× n: n sub-steps per tick. On the frontier: no other row"
        f" is both as accurate and as fast, where errors below {ROUNDING:g} are rounding and count"
        " as equal."
    )
    rk4 = f"{DIGITS} digits, against RK4 with {CHECK_SUBSTEPS} sub-steps in {DIGITS} digits"
    reference = Table(
        "Error of the reference",
        ("the whole loop in exact zero-order hold and decimals", "difference"),
        [
            (f"{DIGITS} digits, against {MORE_DIGITS} digits", f"{scores.digits_error:.1e}"),
            (rk4, f"{scores.method_error:.1e}"),
        ],
        "Over the pulse's peak to peak, as the errors above.",
    )
    tables = (Table.of("Cost per step against error", rows, note), reference)
    return Chapter("The paper's loop", paragraphs, tables, (plot,), _findings(scores))


def _rotor_chapter(scores: IntegratorScores, effort: IntegratorEffort) -> Chapter:
    last_s = ROTOR_TICKS_S[-1]
    radius = spectral_radius(1 / last_s, EXPERIMENT, FILTER_RAD_PER_S)
    words = (
        f"Eq 22 as a rotor that resonates at {ROTOR_HZ:g} Hz. A voltage of k times the pulse"
        f" is held over each tick for {effort.rotor_seconds:g} s, without a controller, so that"
        " any growth comes from the integrator. (The paper's gains on the paper's plant have a"
        f" spectral radius of {radius:.2g} at a tick of {last_s * 1e3:g} ms, with any integrator.)"
    )
    tables = [
        Table(
            f"Error on a rotor with ζ = {damping:g}, by the tick",
            ("integrator", *(f"{tick_s * 1e3:g} ms" for tick_s in ROTOR_TICKS_S)),
            [
                (name, *("grows" if each > GROWN else f"{each:.1e}" for each in row))
                for name, row in errors.items()
            ],
            f"grows: more than {GROWN:g} times the pulse away from the reference.",
        )
        for damping, errors in scores.rotors.items()
    ]
    return Chapter("Harder plants", (words,), tables)


def _findings(scores: IntegratorScores) -> list[str]:
    """Return the verdict on the default, its figures beside the others', and the check of both."""
    default, *others = scores.points
    findings = [
        verdict(scores.points),
        f"Its largest error is {default.error:.1e} of the pulse from peak to peak, at"
        f" {default.cost_us:.2f} µs a step.",
    ]
    # Of each family, the first point has the least cost.
    firsts = {point.family: point for point in reversed(others)}
    written = [firsts[family] for family in WRITTEN_OUT if family in firsts]
    if written:
        listed = "; ".join(
            f"{each.error:.1e} by {each.name}, at {each.cost_us / default.cost_us:.1f} times the"
            " cost"
            for each in written
        )
        findings.append(f"The errors of others with the fewest sub-steps: {listed}.")
    rotors = [rows[DEFAULT] for rows in scores.rotors.values()]
    grows = {
        name
        for rows in scores.rotors.values()
        for name, errors in rows.items()
        if max(errors) > GROWN
    }
    findings.append(
        f"On a resonant rotor, at ticks of {', '.join(f'{1e3 * each:g}' for each in ROTOR_TICKS_S)}"
        f" ms, the error of the default is at most {max(map(max, rotors)):.1e} of the pulse; that"
        " of"
        f" {', '.join(sorted(grows)) or 'no method'} exceeds {GROWN:g} times the pulse at one of"
        " these ticks."
    )
    worst = max(scores.digits_error, scores.method_error)
    findings.append(
        f"The reference agrees with its two checks, more digits and RK4, within {worst:.1e}."
    )
    return findings


def beaten_by(point: IntegratorPoint, points: Sequence[IntegratorPoint]) -> list[IntegratorPoint]:
    """Return the points that are at least as accurate and as fast, and better in one of the two.

    If there are none, the point is on the frontier.
    """

    def figures(of: IntegratorPoint) -> tuple[float, float]:
        return max(of.error, ROUNDING), of.cost_us

    error, cost_us = figures(point)
    return [
        other
        for other in points
        if figures(other) != (error, cost_us)
        and figures(other)[0] <= error
        and figures(other)[1] <= cost_us
    ]


def verdict(points: Sequence[IntegratorPoint]) -> str:
    """Return a sentence on whether the default, the first of the points, is on the frontier."""
    default = points[0]
    better = beaten_by(default, points)
    names = "; ".join(other.name for other in better)
    if better:
        return f"The default, {default.name}, is not on the frontier; it is beaten by: {names}."
    return (
        f"The default, {default.name}, is on the frontier: of the other"
        f" {len(points) - 1} rows, none is both as accurate and as fast."
    )


def _draw(figure: "Figure", points: Sequence[IntegratorPoint]) -> None:
    """Draw error against cost, one line for each family; the default is a star."""
    from matplotlib import rcParams

    default, axes = points[0], figure.add_subplot()
    axes.axhspan(1e-17, ROUNDING, color=rcParams["grid.color"], alpha=0.5, linewidth=0)
    families = dict.fromkeys(point.family for point in points[1:])
    axes.plot(default.cost_us, default.error, "*", markersize=16, label=default.family)
    for style, family in zip(STYLES, families, strict=False):
        line = [point for point in points if point.family == family]
        fill = "full" if family in WRITTEN_OUT else "none"
        costs_us, errors = [point.cost_us for point in line], [point.error for point in line]
        axes.plot(costs_us, errors, style, fillstyle=fill, label=family)
    axes.set(xscale="log", xlabel="cost of a step (µs)")
    axes.set(yscale="log", ylabel="largest error / peak to peak")
    axes.set_ylim(bottom=1e-17)
    axes.text(0.99, 0.01, "rounding", transform=axes.transAxes, ha="right", va="bottom")
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
