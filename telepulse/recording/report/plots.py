"""The plots of a recording's report."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.tracking_error import JND
from protocol.histogram import Histogram
from telepulse.recording.report.findings import RunFindings
from telepulse.recording.report.forces import AlignedBlock, ForceHistory
from telepulse.recording.report.trend import Trend
from telepulse.reports.document import Plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FAINT = 0.3
HOLE_S = 0.1
SHARES = np.concatenate([np.linspace(0.001, 0.99, 150), np.linspace(0.9905, 1, 20)])
TIME = "time in s"
Floats = NDArray[np.float64]


def stretch(name: str, caption: str, blocks: list[AlignedBlock]) -> Plot:
    """Plot force at wrist and finger over some seconds, and their difference in its JND band."""
    t_s, wrist_n, felt_n = _broken(*map(np.concatenate, zip(*blocks, strict=True)))
    jnd_mn = 1e3 * JND * float(np.nanmax(wrist_n) - np.nanmin(wrist_n))

    def draw(figure: "Figure") -> None:
        force, error = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        force.plot(t_s, 1e3 * wrist_n, label="at the wrist")
        force.plot(t_s, 1e3 * felt_n, "--", label="at the finger")
        force.set_ylabel("force in mN")
        _legend(force)
        error.axhspan(-jnd_mn, jnd_mn, alpha=FAINT / 2, color="C2", lw=0, label="JND")
        error.plot(t_s, 1e3 * (felt_n - wrist_n), color="C1", lw=1, label="difference")
        error.set(xlabel=TIME, ylabel="in mN", ylim=_limits(1e3 * (felt_n - wrist_n), jnd_mn))
        _legend(error)

    return Plot(name, caption, draw)


def error(forces: ForceHistory) -> Plot:
    """Plot the difference over the whole time."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        points, jnd = forces.error_n.points(), forces.jnd_n.points()
        axes.fill_between(
            jnd.t_s, -1e3 * jnd.mean, 1e3 * jnd.mean, alpha=FAINT / 2, color="C2", lw=0, label="JND"
        )
        low, high = 1e3 * points.low, 1e3 * points.high
        axes.vlines(points.t_s, low, high, color="C1", lw=1.2, label="least to greatest")
        jnd_mn = float(1e3 * jnd.mean.max()) if len(jnd.mean) else 1.0
        both = np.concatenate([low, high])
        axes.set(xlabel=TIME, ylabel="difference in mN", ylim=_limits(both, jnd_mn))
        _legend(axes)

    return Plot(
        "error",
        "Force felt minus force at the wrist, over the whole time, in the band of the just"
        " noticeable difference: 10 % of the pulse's peak to peak.",
        draw,
    )


def delays(findings: RunFindings) -> Plot:
    """Plot one-way and playout delay over time."""
    trends = findings.trends

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        _range(axes, trends.one_way_ms, "C0", "one way, of frames")
        _range(axes, trends.playout_ms, "C1", "playout, of ticks")
        axes.set(xlabel=TIME, ylabel="delay in ms")
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        _legend(axes)

    return Plot("delays", "Delays over time: mean, and from the least to the greatest.", draw)


def delay_distribution(findings: RunFindings) -> Plot:
    """Plot how many frames and ticks had at most which delay."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        _cumulative(axes, findings.one_way_delay_ms, "one way, of frames")
        _cumulative(axes, findings.playout_ms, "playout, of ticks")
        axes.set(xlabel="delay in ms, at most", ylabel="share in %", ylim=(0, 102))
        _legend(axes)

    return Plot("delay-distribution", "Which share had at most which delay.", draw)


def loss(findings: RunFindings) -> Plot:
    """Plot samples late and lost, by the display's own count."""
    trends = findings.trends

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        _counts(axes, (trends.late, trends.lost), ("late", "lost"))
        axes.set(xlabel=TIME, ylabel=f"samples in {_width(trends.lost)}")
        _legend(axes)

    return Plot("loss", "Samples that came too late or never, by the display's count.", draw)


def clock(findings: RunFindings) -> Plot:
    """Plot offset with its uncertainty, skew, round trips."""
    trends = findings.trends

    def draw(figure: "Figure") -> None:
        offset, skew, trip = figure.subplots(3, 1, sharex=True)
        points, uncertainty = trends.offset_ms.points(), trends.uncertainty_ms.points()
        low, high = points.mean - uncertainty.mean, points.mean + uncertainty.mean
        offset.fill_between(points.t_s, low, high, alpha=FAINT, lw=0)
        offset.plot(points.t_s, points.mean)
        offset.set_ylabel("offset, ms")
        _range(skew, trends.skew_ppm, "C1", "")
        skew.set_ylabel("skew, ppm")
        _range(trip, trends.round_trip_ms, "C2", "")
        trip.set(xlabel=TIME, ylabel="round trip, ms")
        figure.align_ylabels()

    return Plot(
        "clock",
        "The sensing clock against the display's: how far its offset has moved from where it was"
        " first known, with the uncertainty that the display gives it; skew; round trips.",
        draw,
    )


def loop(findings: RunFindings) -> Plot:
    """Plot ticks missed, and how late ticks began."""
    trends = findings.trends

    def draw(figure: "Figure") -> None:
        missed, late = figure.subplots(2, 1, sharex=True)
        _counts(missed, (trends.misses,), ("missed",))
        missed.set_ylabel(f"ticks missed\nin {_width(trends.misses)}")
        for trend, name in ((trends.late_p99_us, "99 of 100"), (trends.late_max_us, "the latest")):
            points = trend.points()
            late.plot(points.t_s, points.mean, label=f"{name}, so far")
        late.set(xlabel=TIME, ylabel="began late by, µs", yscale="log")
        least, most = late.get_ylim()
        late.set_ylim(10 ** np.floor(np.log10(least)), 10 ** np.ceil(np.log10(most)))
        _legend(late)
        figure.align_ylabels()

    return Plot("loop", "The display's real-time loop, by its own count.", draw)


def heart(forces: ForceHistory) -> Plot:
    """Plot the heart rate at both ends."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        t_s, wrist, felt = (np.array(part, float) for part in zip(*forces.heart, strict=True))
        axes.plot(t_s, wrist, "o-", label="at the wrist")
        axes.plot(t_s, felt, "x--", label="at the finger")
        middle = float(np.nanmedian([*wrist, *felt]))
        low, high = np.nanmin([*wrist, *felt]), np.nanmax([*wrist, *felt])
        axes.set(xlabel=TIME, ylabel="beats a minute")
        axes.set_ylim(min(low, middle - 10) - 2, max(high, middle + 10) + 2)
        _legend(axes)

    return Plot("heart-rate", "Heart rate, by the intervals between beats in six seconds.", draw)


def _broken(t_s: Floats, *columns: Floats) -> list[Floats]:
    """Return the columns with a NaN in every hole in time, over which no line is drawn then."""
    holes = np.flatnonzero(np.diff(t_s) > HOLE_S) + 1
    return [np.insert(t_s, holes, t_s[holes]), *(np.insert(c, holes, np.nan) for c in columns)]


def _legend(axes: "Axes") -> None:
    """Place the legend above the plot, where it hides nothing."""
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderpad=0.1)


def _range(axes: "Axes", trend: Trend, color: str, label: str) -> None:
    points = trend.points()
    axes.fill_between(points.t_s, points.low, points.high, alpha=FAINT, color=color, lw=0)
    axes.plot(points.t_s, points.mean, color=color, label=label)


def _cumulative(axes: "Axes", histogram: Histogram, label: str) -> None:
    if histogram.count:
        # Values beyond the range are counted without their place: the line ends before.
        shares = [share for share in SHARES.tolist() if not histogram.beyond(it=share)]
        values: Any = [histogram.quantile(share) for share in shares]
        axes.plot(values, 100 * np.array(shares), label=label)


def _counts(axes: "Axes", trends: tuple[Trend, ...], labels: tuple[str, ...]) -> None:
    bottom: dict[float, float] = {}
    for trend, label in zip(trends, labels, strict=True):
        points = trend.points()
        # Lost samples that come after all are late then.
        counts = np.maximum(points.total, 0)
        below = np.array([bottom.get(at, 0.0) for at in points.t_s.tolist()])
        axes.bar(points.t_s, counts, trend.width_s, bottom=below, label=label)
        bottom.update(zip(points.t_s.tolist(), (below + counts).tolist(), strict=True))
    axes.set_axisbelow(True)
    axes.set_ylim(0, max(1.0, 1.1 * max(bottom.values(), default=0.0)))


def _width(trend: Trend) -> str:
    return f"{trend.width_s:g} s"


def _limits(values: Floats, jnd: float) -> tuple[float, float]:
    """Symmetric, with all the values and the band."""
    largest = max(jnd, float(np.nanmax(np.abs(values), initial=0.0)))
    return -1.25 * largest, 1.25 * largest
