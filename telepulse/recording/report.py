"""The report of a recording: its chapters in their order, and their plots."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import GOOD
from display_node.scoring.tracking_error import JND
from protocol.config.quantities import count_text
from protocol.counters import interruptions_text
from protocol.errors import explain_causes
from protocol.figures import Surface
from protocol.run_summary import REGISTRY, Summary
from telepulse.recording.contactor_findings import ContactorFindings
from telepulse.recording.findings import RecordedEvent, RunFindings, read_findings
from telepulse.recording.forces import AlignedBlock, Trend
from telepulse.recording.press_chapter import press_chapters
from telepulse.reports.document import (
    Chapter,
    Plot,
    Report,
    Table,
    provenance_table,
    text_colour,
)
from telepulse.reports.notation import percent
from telepulse.telemetry.decoder import MARK_EVENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NONE = "–"
LEVELS = {2: "info", 3: "warning", 4: "error"}
WARNING = 3
# Lines in plots over time, and their key in the caption.
MARK_LINE, ALERT_LINE = ":", (0, (5, 2, 1, 2))
KEY = " Vertical lines: marks are dotted, warnings and errors dash-dotted."
FAINT = 0.3
GAP_S = 0.1
SHARES = np.concatenate([np.linspace(0.001, 0.99, 150), np.linspace(0.9905, 1, 20)])
TIME = "time in s"
# Plots of a difference that a press makes meaningless, and why they are left out.
DIFFERENCES = ("force-worst", "error")
PRESSED = (
    "A finger or a sweep pressed the wrist. The force felt then contains the finger's own press,"
    " and the pulse that this press gives, so it is not compared with the pulse at the wrist."
)
Floats = NDArray[np.float64]


def build_recording_report(path: Path) -> Report:
    """Read a recording and report it. Raises SourceError."""
    findings = read_findings(path)
    drawn = _Plots(findings)
    several = len(findings.contactors) > 1
    timed = partial(_with_events, findings.events)
    delays = (
        timed(
            Plot(
                "delays",
                "Delays over time: mean, and from the least to the greatest.",
                drawn.delays,
            )
        ),
        Plot(
            "delay-distribution", "Share of frames and ticks up to each delay.", drawn.distribution
        ),
        timed(
            Plot(
                "loss",
                "Samples that came too late, where no trusted prediction was felt, or never, by the"
                " display's count.",
                drawn.loss,
            )
        ),
    )
    clock = Plot(
        "clock",
        "The sensing clock against the display's: change of the offset since it was first known,"
        " with the display's uncertainty; skew; round trips.",
        drawn.clock,
    )
    loop = Plot("loop", "The display's real-time loop, by its own count.", drawn.loop)
    events = tuple(
        (f"{t_s:.2f}", LEVELS.get(level, str(level)), name, text)
        for t_s, level, name, text in findings.events
    )
    columns = ("time (s)", "level", "event", "text")
    more = f"{findings.more_events} further events are not shown." if findings.more_events else ""
    chapters = [
        Chapter(
            "In short",
            tuple(_paragraphs(findings)),
            (_summary(findings),),
            findings=tuple(_in_short(findings)),
        ),
        *(
            chapter
            for number, contactor in enumerate(findings.contactors)
            for chapter in _contactor_chapters(contactor, number, several, findings)
        ),
        *press_chapters(findings),
        Chapter("Delay and loss", plots=delays),
        Chapter("Clock and loop", plots=(timed(clock), timed(loop))),
        Chapter("What happened", tables=(Table("Events", columns, events, more),)),
    ]
    if findings.about:
        stated = Table(
            "Stated by the person who recorded", ("entry", "text"), tuple(findings.about.items())
        )
        chapters.append(Chapter("About the recording", tables=(stated,)))
    # Recordings of older versions have no provenance.
    if runs := findings.provenance:
        titles = [f"Run {n}" for n in range(1, len(runs) + 1)] if len(runs) > 1 else ["The run"]
        tables = tuple(map(provenance_table, titles, runs))
        chapters.append(Chapter("Provenance of the recording", tables=tables, folded=True))
    return Report(f"Recording {path.name}", tuple(chapters))


def _in_short(findings: RunFindings) -> Iterable[str]:
    """Yield at most five sentences on the run, the result first."""
    summary, own = findings.summary(), findings.display_summary or Summary()
    samples, errors, felt = summary.samples, summary.force_rmse_n, summary.availability.felt
    broken = interruptions_text(own.to_dict()["interruptions"]) or "none"
    shared = "A pulse was not felt" if felt is None else f"A pulse was felt for {percent(felt)}"
    yield f"{shared} of {findings.seconds:.1f} s; interruptions: {broken}."
    delay_ms = summary.playout_delay_ms.mean
    aged = "" if delay_ms is None else f", which was {delay_ms:.1f} ms old on average"
    if errors.aligned is not None and errors.in_phase is not None:
        yield (
            f"The felt force differs by {1e3 * errors.aligned:.2f} mN RMS from the pulse of the"
            f" played instant{aged}, and by {1e3 * errors.in_phase:.2f} mN RMS from the pulse of"
            " the same moment."
        )
    elif aged:
        yield f"The played instant was {delay_ms:.1f} ms old on average."
    if samples.sent:
        yield (
            f"Of {samples.sent} samples, {samples.played} were played, {samples.predicted}"
            f" predicted, {samples.late} late and {samples.lost} lost."
        )
    ticks, missed = summary.loop.ticks or 0, summary.loop.deadline_misses or 0
    gap_ms = own.loop.worst_5s.gap_ms
    longest = "" if gap_ms is None else f"; the longest gap was {gap_ms:.0f} ms"
    if ticks + missed:
        share = percent(missed / (ticks + missed), ".2f")
        yield f"{missed} of {ticks + missed} ticks were missed ({share}){longest}."
    marks = sum(event.name == MARK_EVENT for event in findings.events)
    refused = ", ".join(explain_causes(own.rejected)) or "nothing"
    faults = "; ".join(own.faults) or "none"
    yield f"Refused: {refused}. Faults: {faults}. Marks: {marks or 'none'}."


def _paragraphs(findings: RunFindings) -> Iterable[str]:
    begin = datetime.fromtimestamp((findings.begin_ns or 0) // 1_000_000_000, UTC)
    streams = ", ".join(f"“{name}”" for name in dict.fromkeys(findings.streams)) or "no stream"
    yield (
        f"{streams}, {begin:%Y-%m-%d %H:%M:%S} UTC, {findings.seconds:.1f} s,"
        f" {count_text(len(findings.streams), 'session')} of the sensing node."
    )
    for line in findings.gaps:
        yield f"The recording: {line}."
    if findings.runs > 1:
        yield f"The display was started {findings.runs} times; its own figures are of the last run."
    own_ticks = None if findings.display_summary is None else findings.display_summary.loop.ticks
    if findings.runs == 1 and own_ticks is not None and own_ticks > findings.ticks:
        yield (
            f"The display's own figures count {count_text(own_ticks - findings.ticks, 'tick')} more"
            " than were recorded: from before the recording, or missed by the recorder."
        )


def _summary(findings: RunFindings) -> Table:
    summaries = findings.summary(), findings.display_summary or Summary()
    recorded, own = (REGISTRY.cells(each.to_dict(), Surface.REPORT) for each in summaries)
    rows = [(name, recorded[name] or NONE, own[name] or NONE) for name in recorded]
    for contactor in findings.contactors:
        of = f"{contactor.name}: " if len(findings.contactors) > 1 else ""
        if of:
            ours, display = (
                REGISTRY.cells(
                    figures.to_dict()["contactors"].get(contactor.name, {}), Surface.REPORT
                )
                for figures in summaries
            )
            rows += [(of + name, ours[name] or NONE, display[name] or NONE) for name in ours]
        for place, name in enumerate(("wrist", "finger")):
            rates = [r for _, *ends in contactor.forces.heart if (r := ends[place]) is not None]
            shown = f"{median(rates):.1f} /min" if rates else NONE
            rows.append((f"{of}heart rate at the {name}, median", shown, NONE))
    last = (
        "its final status" if findings.is_final_summary else "its last status, since it never ended"
    )
    return Table(
        "The run",
        ("figure", "from the recording", "the display's own"),
        tuple(row for row in rows if row[1:] != (NONE, NONE)),
        note=f"The display's own: by {last}. From the recording: computed from frames, clock"
        " replies and ticks with the display's own modules. A tick is recorded with the time at"
        " which it was due, not at which it began: samples that arrived in between count as"
        " predicted or late. Ticks missed before the first one and losses after the last frame are"
        " not included.",
    )


def _contactor_chapters(
    contactor: ContactorFindings, number: int, several: bool, findings: RunFindings
) -> tuple[Chapter, ...]:
    """Return the chapters on force and beats; number: of the contactor, from 0."""
    of = f" – {contactor.name}" if several else ""
    ending = f"-{number + 1}" if several else ""
    drawn = _ContactorPlots(contactor)
    force = _force(contactor, drawn, of, ending)
    if findings.pressed:
        plots = [plot for plot in force.plots if not plot.name.startswith(DIFFERENCES)]
        force = Chapter(force.title, (*force.paragraphs, PRESSED), plots=plots)
    return tuple(
        replace(chapter, plots=tuple(_with_events(findings.events, plot) for plot in chapter.plots))
        for chapter in (force, _beats(contactor, drawn, of, ending))
    )


def _with_events(events: Sequence[RecordedEvent], plot: Plot) -> Plot:
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


def _force(contactor: ContactorFindings, drawn: "_ContactorPlots", of: str, ending: str) -> Chapter:
    title, forces, alignment = f"Force{of}", contactor.forces, contactor.forces.alignment
    if alignment.ratio is None or not forces.first:
        return Chapter(title, ("The pulse was never played at its full strength.",))
    first, worst = (_force_plot(blocks) for blocks in (forces.first, forces.worst))
    plots = [
        Plot(f"force-first{ending}", "The first seconds at full strength.", first),
        Plot(f"force-worst{ending}", "Around the largest difference.", worst),
        Plot(
            f"error{ending}",
            "Force felt minus force at the wrist, over the whole time. The band is the just"
            " noticeable difference: 10 % of the pulse's peak to peak.",
            drawn.error,
        ),
    ]
    if forces.heart:
        caption = "Heart rate, by the intervals between beats in six seconds."
        plots.append(Plot(f"heart-rate{ending}", caption, drawn.heart))
    channel = f"channel {alignment.channel}"
    target = (
        f"The target force at the finger is that of {channel} at the wrist"
        if alignment.ratio == 1
        else f"The target force at the finger is {alignment.ratio:.4g} times that of {channel} at"
        " the wrist, so that both strains are equal"
    )
    found = f"{target}. It is shown at the instants that were played, as “at the wrist”."
    return Chapter(title, (found,), plots=tuple(plots))


def _beats(contactor: ContactorFindings, drawn: "_ContactorPlots", of: str, ending: str) -> Chapter:
    if not contactor.trends:
        return Chapter(f"Beats{of}", ("No beat was found in the recorded samples.",))
    caption = (
        "Each beat of the pulse at the wrist: time to the next one, force from foot to peak, and"
        f" quality, the similarity to the good beats before. Below {GOOD:g} a beat is doubtful."
    )
    return Chapter(f"Beats{of}", plots=(Plot(f"beats{ending}", caption, drawn.beats),))


def _force_plot(blocks: list[AlignedBlock]) -> "Callable[[Figure], None]":
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


class _ContactorPlots:
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


class _Plots:
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
