"""Plots of a recording's report, each drawn into an empty figure."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.tracking_error import JND
from telepulse.document import Plot, text_colour
from telepulse.recording.findings import RecordedEvent, RunFindings
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


def with_events(events: Sequence[RecordedEvent], plot: Plot) -> Plot:
    """Add lines at marks and alerts to a plot over time, and their key to its caption."""
    lines = [
        (event.t_s, MARK_LINE if event.name == MARK_EVENT else ALERT_LINE)
        for event in events
        if event.name == MARK_EVENT or event.level >= WARNING
    ]
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


def force_plot(blocks: list[AlignedBlock]) -> "Callable[[Figure], None]":
    """Plot force at wrist and finger over some seconds, and their difference over the JND band."""
    t_s, *forces_n = map(np.concatenate, zip(*blocks, strict=True))
    # A NaN in every gap interrupts the line.
    gaps = np.flatnonzero(np.diff(t_s) > GAP_S) + 1
    t_s = np.insert(t_s, gaps, t_s[gaps])
    wrist_mn, felt_mn = (1e3 * np.insert(force_n, gaps, np.nan) for force_n in forces_n)
    jnd_mn = JND * float(np.nanmax(wrist_mn) - np.nanmin(wrist_mn))

    def draw(figure: "Figure") -> None:
        force, error = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        force.plot(t_s, wrist_mn, label="at the wrist")
        force.plot(t_s, felt_mn, "--", label="at the finger")
        force.set_ylabel("force in mN")
        _legend(force)
        difference_mn = felt_mn - wrist_mn
        error.axhspan(-jnd_mn, jnd_mn, alpha=FAINT / 2, color="C2", lw=0, label="JND")
        error.plot(t_s, difference_mn, color="C1", lw=1, label="difference")
        error.set(xlabel=TIME, ylabel="in mN", ylim=_limits(difference_mn, jnd_mn))
        _legend(error)

    return draw


class ContactorPlots:
    """Plots of one contactor, each drawn into an empty figure."""

    def __init__(self, contactor: ContactorFindings) -> None:
        self._forces, self._trends = contactor.forces, contactor.trends

    def error(self, figure: "Figure") -> None:
        """Plot the difference of the forces over the whole time."""
        axes, forces = figure.subplots(), self._forces
        points, jnd = forces.error_n.points(), forces.jnd_n.points()
        band_mn, low, high = 1e3 * jnd.mean, 1e3 * points.low, 1e3 * points.high
        axes.fill_between(
            jnd.t_s, -band_mn, band_mn, alpha=FAINT / 2, color="C2", lw=0, label="JND"
        )
        axes.vlines(points.t_s, low, high, color="C1", lw=1.2, label="least to greatest")
        jnd_mn = float(band_mn.max()) if len(band_mn) else 1.0
        both = np.concatenate([low, high])
        axes.set(xlabel=TIME, ylabel="difference in mN", ylim=_limits(both, jnd_mn))
        _legend(axes)

    def heart(self, figure: "Figure") -> None:
        """Plot the heart rate at both ends."""
        axes, rates = figure.subplots(), self._forces.heart
        t_s, wrist, felt = (np.array(part, float) for part in zip(*rates, strict=True))
        axes.plot(t_s, wrist, "o-", label="at the wrist")
        axes.plot(t_s, felt, "x--", label="at the finger")
        both = [*wrist, *felt]
        low, middle, high = np.nanmin(both), float(np.nanmedian(both)), np.nanmax(both)
        axes.set(xlabel=TIME, ylabel="beats a minute")
        axes.set_ylim(min(low, middle - 10) - 2, max(high, middle + 10) + 2)
        _legend(axes)

    def beats(self, figure: "Figure") -> None:
        """Plot interval, height and quality of each beat at the wrist."""
        axes = figure.subplots(3, 1, sharex=True)
        for each, name, label in zip(
            axes,
            ("interval_ms", "height_mn", "quality"),
            ("interval in ms", "height in mN", "quality"),
            strict=True,
        ):
            points = self._trends[name].points()
            each.vlines(points.t_s, points.low, points.high, color="C0", lw=1.2)
            each.plot(points.t_s, points.mean, ".", color="C0")
            each.set_ylabel(label)
        axes[-1].set(xlabel=TIME, ylim=(-0.05, 1.05))


class RunPlots:
    """Plots of a recording, each drawn into an empty figure."""

    def __init__(self, findings: RunFindings) -> None:
        self._findings, self._trends = findings, findings.trends

    def delays(self, figure: "Figure") -> None:
        """Plot one-way and playout delay over time."""
        axes = figure.subplots()
        _range(axes, self._trends["one_way_ms"], "C0", "one way, of frames")
        _range(axes, self._trends["playout_ms"], "C1", "playout, of ticks")
        axes.set(xlabel=TIME, ylabel="delay in ms")
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        _legend(axes)

    def distribution(self, figure: "Figure") -> None:
        """Plot the cumulative distributions of the delays of frames and ticks."""
        axes, findings = figure.subplots(), self._findings
        for histogram, label in (
            (findings.one_way_delay_ms, "one way, of frames"),
            (findings.playout_ms, "playout, of ticks"),
        ):
            if histogram.count:
                # Of values beyond its range a histogram has only the count: the line ends there.
                shares = [share for share in SHARES.tolist() if not histogram.is_beyond(share)]
                values: Any = [histogram.quantile(share) for share in shares]
                axes.plot(values, 100 * np.array(shares), label=label)
        axes.set(xlabel="delay in ms, at most", ylabel="share in %", ylim=(0, 102))
        _legend(axes)

    def loss(self, figure: "Figure") -> None:
        """Plot samples late and lost, by the display's own count."""
        axes = figure.subplots()
        self._counts(axes, "late", "lost")
        axes.set(xlabel=TIME, ylabel=f"samples in {self._trends['lost'].width_s:g} s")
        _legend(axes)

    def clock(self, figure: "Figure") -> None:
        """Plot offset with its uncertainty, skew, round trips."""
        offset, skew, trip = figure.subplots(3, 1, sharex=True)
        points = self._trends["offset_ms"].points()
        around = self._trends["uncertainty_ms"].points().mean
        low, high = points.mean - around, points.mean + around
        offset.fill_between(points.t_s, low, high, alpha=FAINT, lw=0)
        offset.plot(points.t_s, points.mean)
        offset.set_ylabel("offset, ms")
        _range(skew, self._trends["skew_ppm"], "C1", "")
        skew.set_ylabel("skew, ppm")
        _range(trip, self._trends["round_trip_ms"], "C2", "")
        trip.set(xlabel=TIME, ylabel="round trip, ms")
        figure.align_ylabels()

    def loop(self, figure: "Figure") -> None:
        """Plot missed ticks and the lateness of ticks."""
        missed, late = figure.subplots(2, 1, sharex=True)
        self._counts(missed, "misses")
        missed.set_ylabel(f"ticks missed\nin {self._trends['misses'].width_s:g} s")
        for name, label in (("late_p99_us", "99th percentile"), ("late_max_us", "maximum")):
            points = self._trends[name].points()
            late.plot(points.t_s, points.mean, label=f"{label} so far")
        late.set(xlabel=TIME, ylabel="began late by, µs", yscale="log")
        least, most = late.get_ylim()
        late.set_ylim(10 ** np.floor(np.log10(least)), 10 ** np.ceil(np.log10(most)))
        _legend(late)
        figure.align_ylabels()

    def _counts(self, axes: "Axes", *names: str) -> None:
        """Draw counts as stacked bars."""
        bottom: dict[float, float] = {}
        for name in names:
            points = self._trends[name].points()
            # A sample that arrives after it was counted as lost becomes predicted or late: the
            # losses decrease.
            counts = np.maximum(points.total, 0)
            below = np.array([bottom.get(at, 0.0) for at in points.t_s.tolist()])
            axes.bar(points.t_s, counts, self._trends[name].width_s, bottom=below, label=name)
            bottom.update(zip(points.t_s.tolist(), (below + counts).tolist(), strict=True))
        axes.set_axisbelow(True)
        axes.set_ylim(0, max(1.0, 1.1 * max(bottom.values(), default=0.0)))


def _legend(axes: "Axes") -> None:
    """Place the legend above the plot, where it hides nothing."""
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderpad=0.1)


def _range(axes: "Axes", trend: Trend, color: str, label: str) -> None:
    points = trend.points()
    axes.fill_between(points.t_s, points.low, points.high, alpha=FAINT, color=color, lw=0)
    axes.plot(points.t_s, points.mean, color=color, label=label)


def _limits(values: Floats, jnd: float) -> tuple[float, float]:
    """Return symmetric limits around all the values and the band."""
    largest = max(jnd, float(np.nanmax(np.abs(values), initial=0.0)))
    return -1.25 * largest, 1.25 * largest
