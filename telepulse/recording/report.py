"""The report of a recording: its chapters in their order."""

from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from statistics import median

from display_node.scoring.beat_quality import GOOD
from protocol.config.quantities import count_text
from protocol.errors import explain_causes
from protocol.summary.figures import Surface
from protocol.summary.phrases import interruptions_text
from protocol.summary.rows import cells
from protocol.summary.tables import Summary
from telepulse.document import Chapter, Plot, Report, Table, percent, provenance_table
from telepulse.recording.findings import RunFindings, read_findings
from telepulse.recording.forces import ContactorFindings
from telepulse.recording.press_chapter import press_chapters
from telepulse.recording.report_plots import ContactorPlots, RunPlots, force_plot, with_events
from telepulse.telemetry.decoder import MARK_EVENT

NONE = "–"
# Columns of the figures: a recording may begin after the display, and end before it.
RECORDED, WHOLE = "recorded span", "whole run (display)"
LEVELS = {2: "info", 3: "warning", 4: "error"}
# Plots of a difference that a press makes meaningless, and why they are left out.
DIFFERENCES = ("force-worst", "error")
PRESSED = (
    "A finger or a sweep pressed the wrist. The force felt then contains the finger's own press,"
    " and the pulse that this press gives, so it is not compared with the pulse at the wrist."
)


def build_recording_report(path: Path) -> Report:
    """Read a recording and report it. Raises SourceError."""
    findings = read_findings(path)
    drawn = RunPlots(findings)
    several = len(findings.contactors) > 1
    timed = partial(with_events, findings.events)
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
    if runs := findings.provenance:
        titles = [f"Run {n}" for n in range(1, len(runs) + 1)] if len(runs) > 1 else ["The run"]
        tables = tuple(map(provenance_table, titles, runs))
        chapters.append(Chapter("Provenance of the recording", tables=tables, folded=True))
    return Report(f"Recording {path.name}", tuple(chapters))


def _in_short(findings: RunFindings) -> Iterable[str]:
    """Yield at most five sentences: on the recorded span, and the last one on the whole run."""
    summary, own = findings.summary(), findings.display_summary or Summary()
    samples, errors, felt = summary.samples, summary.force_rmse_n, summary.availability.felt
    shared = "A pulse was not felt" if felt is None else f"A pulse was felt for {percent(felt)}"
    yield f"{shared} of the {findings.seconds:.1f} s that were recorded."
    delay_ms = summary.playout_delay_ms.mean
    aged = "" if delay_ms is None else f", which was {delay_ms:z.1f} ms old on average"
    if errors.aligned is not None and errors.in_phase is not None:
        yield (
            f"The felt force differs by {1e3 * errors.aligned:.2f} mN RMS from the pulse of the"
            f" played instant{aged}, and by {1e3 * errors.in_phase:.2f} mN RMS from the pulse of"
            " the same moment."
        )
    elif aged:
        yield f"The played instant was {delay_ms:z.1f} ms old on average."
    if samples.sent:
        yield (
            f"Of {samples.sent} samples, {samples.played} were in time, {samples.predicted} felt"
            f" ahead, {samples.late} late and {samples.lost} lost."
        )
    ticks, missed = summary.loop.ticks or 0, summary.loop.deadline_misses or 0
    share = f" ({percent(missed / (ticks + missed), '.2f')})" if ticks + missed else ""
    marks = sum(event.name == MARK_EVENT for event in findings.events) or "none"
    yield f"{missed} of {ticks + missed} ticks were missed{share}. Marks: {marks}."
    if findings.display_summary is None:
        yield "The recording has no figures of the display's whole run."
        return
    gap_ms, seconds = own.loop.worst_5s.gap_ms, own.availability.seconds
    length = "" if seconds is None else f" of {seconds:.1f} s"
    longest = "" if gap_ms is None else f"the longest gap was {gap_ms:.0f} ms; "
    broken = interruptions_text(own.to_dict()["interruptions"]) or "none"
    refused = ", ".join(explain_causes(own.rejected)) or "nothing"
    faults = "; ".join(own.faults) or "none"
    yield (
        f"In the display's whole run{length}, {longest}interruptions: {broken}; refused: {refused};"
        f" faults: {faults}."
    )


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
    if spans := _spans(findings):
        yield spans


def _spans(findings: RunFindings) -> str:
    """Return which span each column of figures covers, where a status states the run's length."""
    own = findings.display_summary or Summary()
    recorded_s, whole_s = findings.summary().availability.seconds, own.availability.seconds
    if recorded_s is None or whole_s is None:
        return ""
    more = (own.loop.ticks or 0) - findings.ticks if findings.runs == 1 else 0
    counted = f", {count_text(more, 'tick')} more than were recorded" if more > 0 else ""
    return (
        f"“{RECORDED}” is {recorded_s:.1f} s of ticks, computed from the recorded messages;"
        f" “{WHOLE}” is {whole_s:.1f} s, counted by the display from its start{counted}."
    )


def _summary(findings: RunFindings) -> Table:
    summaries = findings.summary(), findings.display_summary or Summary()
    recorded, own = (cells(each.to_dict(), Surface.REPORT) for each in summaries)
    rows = [(name, recorded[name] or NONE, own[name] or NONE) for name in recorded]
    for contactor in findings.contactors:
        of = f"{contactor.name}: " if len(findings.contactors) > 1 else ""
        if of:
            ours, display = (
                cells(figures.to_dict()["contactors"].get(contactor.name, {}), Surface.REPORT)
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
        ("figure", RECORDED, WHOLE),
        tuple(row for row in rows if row[1:] != (NONE, NONE)),
        note=f"{_spans(findings)} {WHOLE.capitalize()}: by {last}. {RECORDED.capitalize()}: from"
        " frames, clock replies and ticks, with the display's own modules. A tick is recorded with"
        " the time at which it was due, not at which it began: samples that arrived in between"
        " count as felt ahead or late. Ticks missed before the first one and losses after the last"
        " frame are not included.".strip(),
    )


def _contactor_chapters(
    contactor: ContactorFindings, number: int, several: bool, findings: RunFindings
) -> tuple[Chapter, ...]:
    """Return the chapters on force and beats; number: of the contactor, from 0."""
    of = f" – {contactor.name}" if several else ""
    ending = f"-{number + 1}" if several else ""
    drawn = ContactorPlots(contactor)
    force = _force(contactor, drawn, of, ending)
    if findings.pressed:
        plots = [plot for plot in force.plots if not plot.name.startswith(DIFFERENCES)]
        force = Chapter(force.title, (*force.paragraphs, PRESSED), plots=plots)
    return tuple(
        replace(chapter, plots=tuple(with_events(findings.events, plot) for plot in chapter.plots))
        for chapter in (force, _beats(contactor, drawn, of, ending))
    )


def _force(contactor: ContactorFindings, drawn: ContactorPlots, of: str, ending: str) -> Chapter:
    title, forces, alignment = f"Force{of}", contactor.forces, contactor.forces.alignment
    if alignment.ratio is None or not forces.first:
        return Chapter(title, ("The pulse was never played at its full strength.",))
    first, worst = (force_plot(blocks) for blocks in (forces.first, forces.worst))
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
    # On a busy host each window may have a gap.
    if any(rate is not None for _, *rates in forces.heart for rate in rates):
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


def _beats(contactor: ContactorFindings, drawn: ContactorPlots, of: str, ending: str) -> Chapter:
    if not contactor.trends:
        return Chapter(f"Beats{of}", ("No beat was found in the recorded samples.",))
    caption = (
        "Each beat of the pulse at the wrist: time to the next one, force from foot to peak, and"
        f" quality, the similarity to the good beats before. Below {GOOD:g} a beat is doubtful."
    )
    return Chapter(f"Beats{of}", plots=(Plot(f"beats{ending}", caption, drawn.beats),))
