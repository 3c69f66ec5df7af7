"""The report of the study of integrators: cost per step against error."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from telepulse.document import STYLES, Chapter, Plot, Report, Table
from telepulse.paper.explicit_loop import spectral_radius
from telepulse.paper.published import EXPERIMENT
from telepulse.reports.studies.integrator_scores import (
    CHECK_SUBSTEPS,
    CONTROL,
    DEFAULT,
    DIGITS,
    MORE_DIGITS,
    ROTOR_HZ,
    ROTOR_TICKS_S,
    TICK_S,
    WRITTEN_OUT,
    IntegratorEffort,
    IntegratorPoint,
    IntegratorScores,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOT_INSTALLED = "not installed: pip install 'telepulse[bench]'"
# Corner of the derivative's filter in scenes/paper.toml.
FILTER_RAD_PER_S = 2 * math.pi * 200
# Errors below this are rounding and count as equal.
ROUNDING = 1e-14
# A trajectory further from the reference than this many times the pulse has diverged.
GROWN = 10.0


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
