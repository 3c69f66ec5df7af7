"""Work against precision: what a step costs, and which points no other beats on both."""

import itertools
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from telepulse.reports.studies.integrators import Step

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Errors below this are rounding and count as equal.
ROUNDING = 1e-14
LEAST_PLAY_S = 2e-3
# Markers and lines, so that families that lie on each other can still be told apart.
STYLES = ("o-", "s-", "x--", "^-", "v-", "P-", "<-", ">-")


@dataclass(frozen=True, slots=True)
class Point:
    """An integrator at one setting: its error over the pulse's peak to peak, its µs a step.

    Points of one family are one line of the plot.
    """

    family: str
    name: str
    error: float
    cost_us: float
    library: bool = False


def beaten_by(point: Point, points: Sequence[Point]) -> list[Point]:
    """The points at least as accurate and as fast as this one, and better in one of the two.

    Where there are none, the point is on the frontier.
    """

    def error(of: Point) -> float:
        return max(of.error, ROUNDING)

    return [
        other
        for other in points
        if error(other) <= error(point)
        and other.cost_us <= point.cost_us
        and (error(other) < error(point) or other.cost_us < point.cost_us)
    ]


def verdict(default: Point, points: Sequence[Point]) -> str:
    """One sentence: whether the default is on the frontier of these points."""
    better = beaten_by(default, points)
    if better:
        names = "; ".join(other.name for other in better)
        return f"The default, {default.name}, is not on the frontier; it is beaten by: {names}."
    return (
        f"The default, {default.name}, is on the frontier: of the other"
        f" {len(points) - 1} rows, none is both as accurate and as fast."
    )


def costs_us(
    makes: Sequence[Callable[[], Step[float]]], voltages: Sequence[float], rounds: int
) -> list[float]:
    """Median cost of a step of each stepper in µs of processor time, for the same voltages.

    The steppers take turns, so that a busy moment of the machine falls on all alike. Making a
    stepper is not in its cost.
    """
    costs: list[list[float]] = [[] for _ in makes]
    for _ in range(rounds):
        for make, taken in zip(makes, costs, strict=True):
            taken.append(_cost_us(make(), voltages))
    return [statistics.median(taken) for taken in costs]


def _cost_us(step: Step[float], voltages: Sequence[float]) -> float:
    # The processor's time: what else runs on the machine is not in it.
    plays, elapsed_s, began_s = 0, 0.0, time.process_time()
    while elapsed_s < LEAST_PLAY_S:
        for volts in voltages:
            step(volts)
        plays += 1
        elapsed_s = time.process_time() - began_s
    return elapsed_s / plays / len(voltages) * 1e6


def draw(figure: "Figure", points: Sequence[Point], default: Point) -> None:
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
