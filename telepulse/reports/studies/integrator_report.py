"""The study of integrators as a report: cost a step against error, the frontier, harder plants."""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

from telepulse.reports.document import Chapter, Plot, Report, Table
from telepulse.reports.studies.integrator_scores import (
    CHECK_SUBSTEPS,
    CONTROL,
    DIGITS,
    MORE_DIGITS,
    ROTOR_HZ,
    ROTOR_TICKS_S,
    TICK_S,
    IntegratorEffort,
    IntegratorPoint,
    IntegratorScores,
    LoopScores,
)
from telepulse.reports.studies.integrators import PAPER_PLANT, loop_radius

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Errors below this are rounding and count as equal.
ROUNDING = 1e-14
# Markers and lines, so that families that lie on each other can still be distinguished.
STYLES = ("o-", "s-", "x--", "^-", "v-", "P-", "<-", ">-")
NOT_INSTALLED = "not installed: pip install 'telepulse[bench]'"
# A trajectory further from the reference than this many times the pulse has diverged.
GROWN = 10.0


def report_integrators(scores: IntegratorScores, effort: IntegratorEffort) -> Report:
    """Return the report on scores that took this effort."""
    return Report(
        "Integration methods on the paper's loop: cost a step against error",
        (_loop_chapter(scores, effort), _rotor_chapter(scores, effort)),
    )


def _loop_chapter(scores: IntegratorScores, effort: IntegratorEffort) -> Chapter:
    points, default = scores.loop.points, scores.loop.points[0]
    radius = loop_radius(PAPER_PLANT, TICK_S)
    return Chapter(
        "The paper's loop",
        (
            verdict(default, points),
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
            f" {scores.loop.whole_us:.2g} µs a tick; a loop cannot be closed that way.",
        ),
        (_points_table(scores), _reference_table(scores.loop)),
        (
            Plot(
                "work-precision",
                "Largest error against cost of a step. The star is the default; libraries are"
                " hollow; in the shaded band, errors are rounding and count as equal.",
                lambda figure: _draw(figure, points, default),
            ),
        ),
    )


def _points_table(scores: IntegratorScores) -> Table:
    points, default = scores.loop.points, scores.loop.points[0]
    rows = [
        (
            point.name,
            f"{point.error:.1e}",
            f"{point.cost_us:.2f}",
            f"{point.cost_us / default.cost_us:.1f}",
            "" if beaten_by(point, points) else "yes",
        )
        for point in points
    ]
    if not scores.has_control:
        rows.append((f"{CONTROL}: {NOT_INSTALLED}", "", "", "", ""))
    return Table(
        "Cost a step against error",
        ("integrator", "error", "µs a step", "× default", "frontier"),
        tuple(rows),
        f"{verdict(default, points)} × n: n sub-steps a tick. On the frontier: no other row"
        f" is both as accurate and as fast, where errors below {ROUNDING:g} are rounding and count"
        " as equal.",
    )


def _reference_table(scores: LoopScores) -> Table:
    return Table(
        "Error of the reference",
        ("the whole loop in exact zero-order hold and decimals", "difference"),
        (
            (f"{DIGITS} digits, against {MORE_DIGITS} digits", f"{scores.digits_error:.1e}"),
            (
                f"{DIGITS} digits, against RK4 with {CHECK_SUBSTEPS} sub-steps in {DIGITS} digits",
                f"{scores.method_error:.1e}",
            ),
        ),
        "Over the pulse's peak to peak, as the errors above.",
    )


def _rotor_chapter(scores: IntegratorScores, effort: IntegratorEffort) -> Chapter:
    last_s = ROTOR_TICKS_S[-1]
    return Chapter(
        "Harder plants",
        (
            f"Eq 22 as a rotor that resonates at {ROTOR_HZ:g} Hz. A voltage of k times the pulse"
            f" is held over each tick for {effort.rotor_seconds:g} s, without a controller, so that"
            " any growth comes from the integrator. (The paper's gains on the paper's plant have a"
            f" spectral radius of {loop_radius(PAPER_PLANT, last_s):.2g} at a tick of"
            f" {last_s * 1e3:g} ms, with any integrator.)",
        ),
        tuple(
            Table(
                f"Error on a rotor with ζ = {damping:g}, by the tick",
                ("integrator", *(f"{tick_s * 1e3:g} ms" for tick_s in ROTOR_TICKS_S)),
                tuple((name, *map(_error_or_grows, row)) for name, row in errors.items()),
                f"grows: more than {GROWN:g} times the pulse away from the reference.",
            )
            for damping, errors in scores.rotors.items()
        ),
    )


def _error_or_grows(error: float) -> str:
    return "grows" if error > GROWN else f"{error:.1e}"


def beaten_by(point: IntegratorPoint, points: Sequence[IntegratorPoint]) -> list[IntegratorPoint]:
    """Return the points at least as accurate and as fast, and better in one of the two.

    Where there are none, the point is on the frontier.
    """

    def error(of: IntegratorPoint) -> float:
        return max(of.error, ROUNDING)

    return [
        other
        for other in points
        if error(other) <= error(point)
        and other.cost_us <= point.cost_us
        and (error(other) < error(point) or other.cost_us < point.cost_us)
    ]


def verdict(default: IntegratorPoint, points: Sequence[IntegratorPoint]) -> str:
    """Return a sentence on whether the default is on the frontier of these points."""
    better = beaten_by(default, points)
    if better:
        names = "; ".join(other.name for other in better)
        return f"The default, {default.name}, is not on the frontier; it is beaten by: {names}."
    return (
        f"The default, {default.name}, is on the frontier: of the other"
        f" {len(points) - 1} rows, none is both as accurate and as fast."
    )


def _draw(figure: "Figure", points: Sequence[IntegratorPoint], default: IntegratorPoint) -> None:
    """Draw error against cost, a line a family; the default is a star, libraries are hollow."""
    from matplotlib import rcParams

    axes = figure.add_subplot()
    axes.axhspan(1e-17, ROUNDING, color=rcParams["grid.color"], alpha=0.5, linewidth=0)
    families = dict.fromkeys(point.family for point in points if point != default)
    axes.plot(default.cost_us, default.error, "*", markersize=16, label=default.family)
    for style, family in zip(itertools.cycle(STYLES), families, strict=False):
        line = [point for point in points if point.family == family]
        axes.plot(
            [point.cost_us for point in line],
            [point.error for point in line],
            style,
            fillstyle="none" if line[0].library else "full",
            label=family,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(bottom=1e-17)
    axes.set_xlabel("cost of a step (µs)")
    axes.set_ylabel("largest error / peak to peak")
    axes.text(0.99, 0.01, "rounding", transform=axes.transAxes, ha="right", va="bottom")
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
