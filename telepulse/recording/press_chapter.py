"""The chapter of a recording's report on a press or a sweep: press, hold-down, and the height."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from display_node.scoring.beat_quality import GOOD
from display_node.scoring.depth_curve import BeatPoint, fit_depth_curve
from protocol.config.quantities import count_text
from protocol.errors import DepthError
from telepulse.document import Chapter, Plot
from telepulse.recording.depth_report import height_plot
from telepulse.recording.findings import RunFindings
from telepulse.recording.pressed_beats import MOST_BEATS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIME = "time in s"
FAINT = 0.3


def press_chapters(findings: RunFindings) -> Iterator[Chapter]:
    """Yield the chapter on the press, where the recorded stream has a hold-down."""
    if "wrist_hold_down_n" not in findings.trends:
        return
    words, plots = [], [_over_time(findings)]
    points, beats = findings.depth.points(), findings.depth.count
    try:
        curve = fit_depth_curve(points)
    except DepthError as error:
        words.append(f"No curve of the pulse's height against the hold-down: {error}.")
        if points:
            plots.append(_beats(points))
    else:
        largest_mn, best_n = 1e3 * curve.largest_n.value, curve.best_n.value
        words.append(
            f"The pulse is highest, {largest_mn:.0f} mN, at a hold-down of {best_n:.2f} N;"
            f" {len(curve.good)} of {count_text(len(points), 'beat')} at a steady hold-down are"
            " good."
        )
        if curve.at_end:
            words.append(f"{curve.at_end[0].upper()}{curve.at_end[1:]}.")
        plots.append(height_plot(curve))
    if beats > MOST_BEATS:
        words.append(f"The curve is of the last {MOST_BEATS} of {beats} beats.")
    yield Chapter("Press and hold-down", tuple(words), plots=tuple(plots))


def _over_time(findings: RunFindings) -> Plot:
    trends = findings.trends
    shown = [("wrist_hold_down_n", "hold-down at the wrist")]
    if "press_n" in trends:
        shown.insert(0, ("press_n", "press of the finger"))

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        for number, (name, label) in enumerate(shown):
            points = trends[name].points()
            color = f"C{number}"
            axes.fill_between(points.t_s, points.low, points.high, alpha=FAINT, color=color, lw=0)
            axes.plot(points.t_s, points.mean, color=color, label=label)
        axes.set(xlabel=TIME, ylabel="force (N)")
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderpad=0.1)

    what = " and ".join(label for _, label in shown)
    caption = f"{what[0].upper()}{what[1:]}: means, and from the least to the greatest."
    return Plot("press", caption, draw)


def _beats(points: list[BeatPoint]) -> Plot:
    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        for style, label, good in (("o", "beats", True), ("x", "doubtful beats", False)):
            chosen = [point for point in points if (point.quality >= GOOD) is good]
            heights_mn = [1e3 * point.height_n for point in chosen]
            forces_n = [point.hold_down_n for point in chosen]
            axes.plot(forces_n, heights_mn, style, ms=4, label=label)
        axes.set(xlabel="hold-down (N)", ylabel="height of the pulse (mN)")
        axes.set_ylim(bottom=0)
        axes.legend()

    return Plot("height", "Height of the beats against hold-down.", draw)
