"""Plots of a recording's report, with their captions."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import GOOD
from telepulse.document import Plot, text_colour
from telepulse.recording.findings import HELD, RunFindings
from telepulse.recording.forces import AlignedBlock, ContactorFindings, Trend
from telepulse.telemetry.decoder import MARK_EVENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WARNING = 3
# Lines in plots over time, and their key in the caption.
MARK_LINE, ALERT_LINE = ":", (0, (5, 2, 1, 2))
KEY = " Vertical lines: marks are dotted, warnings and errors dash-dotted."
FAINT = 0.3
GAP_S = 0.1
SHARES = np.concatenate([np.linspace(0.001, 0.99, 150), np.linspace(0.9905, 1, 20)])
TIME = "time in s"
Floats = NDArray[np.float64]


def with_events(findings: RunFindings, plot: Plot) -> Plot:
    """Add lines at marks and alerts to a plot over time, and their key to its caption."""
    shown = [e for e in findings.events if e.name == MARK_EVENT or e.level >= WARNING]
    times_s = findings.times_s([event.unix_ns for event in shown]).tolist()
    styles = [MARK_LINE if event.name == MARK_EVENT else ALERT_LINE for event in shown]
    lines = list(zip(times_s, styles, strict=True))
    if not lines:
        return plot

    def draw(figure: "Figure") -> None:
        plot.draw(figure)
        for axes in figure.axes:
            left, right = axes.get_xlim()
            for t_s, style in lines:
                if left <= t_s <= right:
                    axes.axvline(t_s, ls=style, lw=0.9, color=text_colour(), alpha=0.7)
            axes.set_xlim(left, right)

    return Plot(plot.name, plot.caption + KEY, draw)


def force_plot(name: str, caption: str, blocks: Sequence[AlignedBlock]) -> Plot:
    """Return the plot of force at wrist and finger over some seconds, and of their difference."""
    t_s, *forces_n = map(np.concatenate, zip(*blocks, strict=True))
    # A NaN in every gap interrupts the line.
    gaps = np.flatnonzero(np.diff(t_s) > GAP_S) + 1
    t_s = np.insert(t_s, gaps, t_s[gaps])
    wrist_mn, felt_mn, jnd_mn = (1e3 * np.insert(force_n, gaps, np.nan) for force_n in forces_n)

    def draw(figure: "Figure") -> None:
        force, error = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        force.plot(t_s, wrist_mn, label="at the wrist")
        force.plot(t_s, felt_mn, "--", label="at the finger")
        force.set_ylabel("force in mN")
        _legend(force)
        difference_mn = felt_mn - wrist_mn
        error.fill_between(t_s, -jnd_mn, jnd_mn, alpha=FAINT / 2, color="C2", lw=0, label="JND")
        error.plot(t_s, difference_mn, color="C1", lw=1, label="difference")
        limits = _limits(difference_mn, float(np.nanmax(jnd_mn)))
        error.set(xlabel=TIME, ylabel="in mN", ylim=limits)
        _legend(error)

    return Plot(name, caption, draw)


def error_plot(name: str, contactor: ContactorFindings) -> Plot:
    """Return the plot of the difference of the forces over the whole time."""

    def draw(figure: "Figure") -> None:
        axes, error, jnd = figure.subplots(), contactor.error_n, contactor.jnd_n
        band_mn, low, high = 1e3 * jnd.mean, 1e3 * error.low, 1e3 * error.high
        axes.fill_between(
            jnd.t_s, -band_mn, band_mn, alpha=FAINT / 2, color="C2", lw=0, label="JND"
        )
        axes.vlines(error.t_s, low, high, color="C1", lw=1.2, label="least to greatest")
        limits = _limits(np.concatenate([low, high]), float(band_mn.max()))
        axes.set(xlabel=TIME, ylabel="difference in mN", ylim=limits)
        _legend(axes)

    caption = (
        "Force felt minus force at the wrist, over the whole time. The band is the just noticeable"
        " difference: 10 % of the pulse's peak to peak."
    )
    return Plot(name, caption, draw)


def heart_plot(name: str, contactor: ContactorFindings) -> Plot:
    """Return the plot of the heart rate at both ends."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        t_s, wrist, felt = (np.array(part, float) for part in zip(*contactor.heart, strict=True))
        axes.plot(t_s, wrist, "o-", label="at the wrist")
        axes.plot(t_s, felt, "x--", label="at the finger")
        both = [*wrist, *felt]
        low, middle, high = np.nanmin(both), float(np.nanmedian(both)), np.nanmax(both)
        axes.set(xlabel=TIME, ylabel="beats a minute")
        axes.set_ylim(min(low, middle - 10) - 2, max(high, middle + 10) + 2)
        _legend(axes)

    return Plot(name, "Heart rate, by the intervals between beats in six seconds.", draw)


def beats_plot(name: str, contactor: ContactorFindings) -> Plot:
    """Return the plot of interval, height and quality of each beat at the wrist."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots(3, 1, sharex=True)
        labels = ("interval in ms", "height in mN", "quality")
        for each, trend, label in zip(axes, contactor.trends.values(), labels, strict=True):
            each.vlines(trend.t_s, trend.low, trend.high, color="C0", lw=1.2)
            each.plot(trend.t_s, trend.mean, ".", color="C0")
            each.set_ylabel(label)
        axes[-1].set(xlabel=TIME, ylim=(-0.05, 1.05))

    caption = (
        "Each beat of the pulse at the wrist: time to the next one, force from foot to peak, and"
        f" quality, the similarity to the good beats before. Below {GOOD:g} a beat is doubtful."
    )
    return Plot(name, caption, draw)


def delay_plots(findings: RunFindings) -> tuple[Plot, Plot]:
    """Return the plots of one-way and playout delay: over time, and their distributions."""
    one_way, playout = "one way, of frames", "playout, of ticks"

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        _draw_range(axes, findings.trends["one_way_ms"], "C0", one_way)
        _draw_range(axes, findings.trends["playout_ms"], "C1", playout)
        axes.set(xlabel=TIME, ylabel="delay in ms")
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        _legend(axes)

    def draw_shares(figure: "Figure") -> None:
        axes, received = figure.subplots(), findings.contents.receiver.one_way_delay_ms
        for histogram, label in ((received, one_way), (findings.playout_ms, playout)):
            if histogram.count:
                # Of values beyond its range a histogram has only the count: the line ends there.
                shares = [share for share in SHARES.tolist() if not histogram.is_beyond(share)]
                values: Any = [histogram.quantile(share) for share in shares]
                axes.plot(values, 100 * np.array(shares), label=label)
        axes.set(xlabel="delay in ms, at most", ylabel="share in %", ylim=(0, 102))
        _legend(axes)

    return (
        Plot("delays", "Delays over time: mean, and from the least to the greatest.", draw),
        Plot("delay-distribution", "Share of frames and ticks up to each delay.", draw_shares),
    )


def loss_plot(findings: RunFindings) -> Plot:
    """Return the plot of samples late and lost."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        width_s = _counts(axes, findings, "late", "lost")
        axes.set(xlabel=TIME, ylabel=f"samples in {width_s:g} s")
        _legend(axes)

    caption = (
        "Samples that came too late, where no trusted prediction was felt, or never, by the"
        " display's count."
    )
    return Plot("loss", caption, draw)


def clock_plot(findings: RunFindings) -> Plot:
    """Return the plot of offset with its uncertainty, skew, round trips."""

    def draw(figure: "Figure") -> None:
        axes, trends = figure.subplots(3, 1, sharex=True), findings.trends
        offset, around = trends["offset_ms"], trends["uncertainty_ms"].mean
        low, high = offset.mean - around, offset.mean + around
        axes[0].fill_between(offset.t_s, low, high, alpha=FAINT, lw=0)
        axes[0].plot(offset.t_s, offset.mean)
        _draw_range(axes[1], trends["skew_ppm"], "C1", "")
        _draw_range(axes[2], trends["round_trip_ms"], "C2", "")
        for each, label in zip(axes, ("offset, ms", "skew, ppm", "round trip, ms"), strict=True):
            each.set_ylabel(label)
        axes[2].set_xlabel(TIME)
        figure.align_ylabels()

    caption = (
        "The sensing clock against the display's: change of the offset since it was first known,"
        " with the display's uncertainty; skew; round trips."
    )
    return Plot("clock", caption, draw)


def loop_plot(findings: RunFindings) -> Plot:
    """Return the plot of missed ticks and the lateness of ticks."""

    def draw(figure: "Figure") -> None:
        missed, late = figure.subplots(2, 1, sharex=True)
        width_s = _counts(missed, findings, "misses")
        missed.set_ylabel(f"ticks missed\nin {width_s:g} s")
        for name, label in (("late_p99_us", "99th percentile"), ("late_max_us", "maximum")):
            points = findings.trends[name]
            late.plot(points.t_s, points.mean, label=f"{label} so far")
        late.set(xlabel=TIME, ylabel="began late by, µs", yscale="log")
        least, most = late.get_ylim()
        late.set_ylim(10 ** np.floor(np.log10(least)), 10 ** np.ceil(np.log10(most)))
        _legend(late)
        figure.align_ylabels()

    return Plot("loop", "The display's real-time loop, by its own count.", draw)


def press_plot(findings: RunFindings) -> Plot:
    """Return the plot of the hold-down at the wrist, and of the press of the finger."""
    trends = findings.trends
    shown = [(HELD, "hold-down at the wrist")]
    if len(trends["press_n"].t_s):
        shown.insert(0, ("press_n", "press of the finger"))

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        for number, (name, label) in enumerate(shown):
            _draw_range(axes, trends[name], f"C{number}", label)
        axes.set(xlabel=TIME, ylabel="force (N)")
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderpad=0.1)

    what = " and ".join(label for _, label in shown)
    caption = f"{what[0].upper()}{what[1:]}: means, and from the least to the greatest."
    return Plot("press", caption, draw)


def _draw_range(axes: "Axes", trend: Trend, color: str, label: str) -> None:
    """Draw means, and the range from the least to the greatest."""
    axes.fill_between(trend.t_s, trend.low, trend.high, alpha=FAINT, color=color, lw=0)
    axes.plot(trend.t_s, trend.mean, color=color, label=label)


def _counts(axes: "Axes", findings: RunFindings, *names: str) -> float:
    """Draw counts as stacked bars; return the time in s of one bar."""
    bottom: dict[float, float] = {}
    for name in names:
        trend = findings.trends[name]
        # A sample that arrives after it was counted as lost becomes predicted or late: the losses
        # decrease.
        counts = np.maximum(trend.total, 0)
        below = np.array([bottom.get(at, 0.0) for at in trend.t_s.tolist()])
        axes.bar(trend.t_s, counts, trend.width_s, bottom=below, label=name)
        bottom.update(zip(trend.t_s.tolist(), (below + counts).tolist(), strict=True))
    axes.set_axisbelow(True)
    axes.set_ylim(0, max(1.0, 1.1 * max(bottom.values(), default=0.0)))
    return trend.width_s


def _legend(axes: "Axes") -> None:
    """Place the legend above the plot, where it hides nothing; none where nothing has a name."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderpad=0.1)


def _limits(values: Floats, jnd: float) -> tuple[float, float]:
    """Return symmetric limits around all the values and the band."""
    largest = max(jnd, float(np.nanmax(np.abs(values), initial=0.0)))
    return -1.25 * largest, 1.25 * largest
