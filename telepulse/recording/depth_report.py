"""The report of a sweep: the pulse against the hold-down, the best force and the three levels."""

import math
import statistics
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from display_node.press.sweep import SweptLevel
from display_node.scoring.beat_quality import GOOD
from display_node.scoring.depth_curve import LEVEL_SHARE, BeatPoint, DepthCurve, Estimate
from telepulse.document import Chapter, Plot, Report, Table, percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NONE = "–"
# The levels' names in the literature, by ours.
NAMES = {"light": "fu, superficial", "deeper": "zhong, middle", "deepest": "chen, deep"}
RULES = {
    "light": f"below the best, {percent(LEVEL_SHARE, '.0f')} of the largest height",
    "deeper": "the best: the largest height, where flat the lowest such force",
    "deepest": f"above the best, {percent(LEVEL_SHARE, '.0f')} of the largest height",
}


def describe_level(level: SweptLevel) -> str:
    """Return a line about a level that is complete."""
    cells = _cells(level)
    height, mean = cells["height (mN)"], cells["mean (%)"]
    return (
        f"{cells['hold-down (N)']} N: height {height} mN, mean {mean} %, upstroke"
        f" {cells['upstroke (%)']} %, flat {cells['flat (%)']} %, {cells['good beats']} beats"
    )


def report_depth(
    curve: DepthCurve,
    levels: Sequence[SweptLevel],
    notes: Sequence[str],
    source: str,
    modelled: bool,
) -> Report:
    """Return the report of a sweep.

    source: what was pressed, for the title: the scene of a modelled wrist, or an address.
    """
    best, largest, good = curve.best_n, curve.largest_n, curve.good
    wrist = "modelled wrist" if modelled else "wrist"
    reached = {name: found for name, found in curve.levels().items() if found is not None}
    forces = ", ".join(f"{name} {found.value:.2f} N" for name, found in reached.items())
    findings = [
        f"The pulse of the {wrist} is highest, {1e3 * largest.value:.0f} mN, at a hold-down of"
        f" {best.value:.2f} N.",
        f"Levels by shares of this curve: {forces}.",
        f"{len(good)} of {len(curve.points)} beats are good, at {len(levels)} forces.",
    ]
    words = [f"{note[0].upper()}{note[1:]}." for note in (*notes, curve.at_end or "") if note]
    rows = [
        {
            "level": f"{name} ({NAMES[name]})",
            "hold-down (N)": _estimate(found),
            "height (mN)": NONE if found is None else f"{1e3 * _height_n(curve, found.value):.0f}",
            "rule": RULES[name],
        }
        for name, found in curve.levels().items()
    ]
    note = (
        f"By shares of this {wrist}'s curve, not by fixed forces. ±: one standard deviation of the"
        f" fit. {NONE}: the sweep did not get there."
    )
    chapters = (
        Chapter(
            "The three levels",
            words,
            (Table.of("Levels", rows, note),),
            (height_plot(curve.points, curve),),
            findings,
        ),
        _shape_chapter(levels, good),
    )
    title = f"{wrist} of the scene {source}" if modelled else source
    return Report(f"Sweep of the hold-down: {title}", chapters)


def _shape_chapter(levels: Sequence[SweptLevel], good: Sequence[BeatPoint]) -> Chapter:
    words = (
        "Medians of the good beats. Mean: of the pulse above its foot, over the height. Upstroke"
        " and notch: times from the onset to the peak and to the dicrotic notch, over the beat."
        " Flat: share of the beat within a tenth of its height above the foot, which grows where"
        " the artery is closed in diastole."
    )

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        forces = [point.hold_down_n for point in good]
        for style, (name, values) in zip("o^sx", _shapes(good).items(), strict=True):
            axes.plot(forces, 100 * np.array(values), style, ms=4, label=name)
        axes.set(xlabel="hold-down (N)", ylabel="share (%)")
        axes.legend()

    ordered = sorted(levels, key=lambda level: level.hold_down_n)
    table = Table.of("Pulse by hold-down", [_cells(each) for each in ordered])
    return Chapter("Shape", (words,), (table,), (Plot("shape", "Shape against hold-down.", draw),))


def height_plot(points: Sequence[BeatPoint], curve: DepthCurve | None = None) -> Plot:
    """Return the plot of the beats' heights and, where there is one, their curve."""
    caption = "Height of the pulse against hold-down"
    caption += "." if curve is None else ", and the three levels."

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        if curve is not None:
            height_mn, band_mn = 1e3 * curve.height_n, 2e3 * curve.deviation_n
            low_mn, high_mn = height_mn - band_mn, height_mn + band_mn
            axes.fill_between(curve.force_n, low_mn, high_mn, alpha=0.3, lw=0)
            axes.plot(curve.force_n, height_mn, label="fitted, with two deviations")
        for style, label, good in (("o", "beats", True), ("x", "doubtful beats", False)):
            chosen = [point for point in points if (point.quality >= GOOD) is good]
            heights_mn = [1e3 * point.height_n for point in chosen]
            axes.plot([each.hold_down_n for each in chosen], heights_mn, style, ms=4, label=label)
        for name, found in (curve.levels() if curve else {}).items():
            if found is not None:
                axes.axvline(found.value, ls=":", color="C1")
                axes.annotate(name, (found.value, 0), rotation=90, va="bottom", ha="right")
        axes.set(xlabel="hold-down (N)", ylabel="height of the pulse (mN)")
        axes.set_ylim(bottom=0, top=1.3e3 * curve.largest_n.value if curve else None)
        axes.legend()

    return Plot("height", caption, draw)


def _cells(level: SweptLevel) -> dict[str, str]:
    """Return a level as a row of the table."""
    good = level.good if level.height_n else []
    shapes = {f"{name} (%)": _median(values) for name, values in _shapes(good).items()}
    return {
        "hold-down (N)": f"{level.hold_down_n:.2f}",
        "height (mN)": f"{1e3 * level.height_n:.0f}",
        **shapes,
        "good beats": f"{len(level.good)} of {len(level.points)}",
    }


def _shapes(points: Sequence[BeatPoint]) -> dict[str, list[float]]:
    return {
        "mean": [point.mean for point in points],
        "upstroke": [point.upstroke for point in points],
        "notch": [point.notch for point in points],
        "flat": [point.flat for point in points],
    }


def _median(values: Sequence[float]) -> str:
    """Return the median in per cent of the values that are there, if they are most of them."""
    known = [value for value in values if not math.isnan(value)]
    return f"{100 * statistics.median(known):.0f}" if 2 * len(known) > len(values) else NONE


def _height_n(curve: DepthCurve, force_n: float) -> float:
    return float(np.interp(force_n, curve.force_n, curve.height_n))


def _estimate(found: Estimate | None) -> str:
    """Return a value with its deviation, to the digit in which the deviation shows."""
    if found is None:
        return NONE
    digits = 2 if found.deviation >= 0.005 else 3
    least = 10.0**-digits
    value = f"{found.value:.{digits}f}"
    if found.deviation < least / 2:
        return f"{value} (± below {least:g})"
    return f"{value} ± {found.deviation:.{digits}f}"
