"""The report of a recording: its chapters in their order."""

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

from display_node.scoring.depth_curve import fit_depth_curve
from protocol.config.quantities import count_text
from protocol.errors import DepthError
from protocol.refusals import explain_causes
from protocol.summary.fields import Summary
from protocol.summary.figures import Surface
from protocol.summary.phrases import NEWTONS, interruptions_text
from protocol.summary.rows import cells
from telepulse.document import Chapter, Plot, Report, Table, percent, provenance_table
from telepulse.recording.depth_report import height_plot
from telepulse.recording.findings import HELD, RunFindings, read_findings
from telepulse.recording.forces import ContactorFindings
from telepulse.recording.pressed_beats import judge_beats
from telepulse.recording.report_plots import (
    beats_plot,
    clock_plot,
    delay_plots,
    error_plot,
    force_plot,
    heart_plot,
    loop_plot,
    loss_plot,
    press_plot,
    with_events,
)
from telepulse.telemetry.decoder import MARK_EVENT

NONE = "–"
# Columns of the figures: a recording may begin after the display, and end before it.
RECORDED, WHOLE = "recorded span", "whole run (display)"
# The curve is fitted to the last beats, so many of which take a second or two.
MOST_BEATS = 300
LEVELS = {2: "info", 3: "warning", 4: "error"}
# A press makes the difference of the forces meaningless, so that its plots are left out.
PRESSED = (
    "A finger or a sweep pressed the wrist. The force felt then contains the finger's own press,"
    " and the pulse that this press gives, so it is not compared with the pulse at the wrist."
)


def build_recording_report(path: Path) -> Report:
    """Read a recording and report it. Raises SourceError."""
    findings = read_findings(path)
    delays, distribution = delay_plots(findings)
    delays, loss, clock, loop = (
        with_events(findings, plot)
        for plot in (delays, loss_plot(findings), clock_plot(findings), loop_plot(findings))
    )
    events = tuple(
        (f"{t_s:.2f}", LEVELS.get(event.level, str(event.level)), event.name, event.text)
        for t_s, event in zip(
            findings.times_s([event.unix_ns for event in findings.events]),
            findings.events,
            strict=True,
        )
    )
    columns = ("time (s)", "level", "event", "text")
    more = f"{findings.more_events} further events are not shown." if findings.more_events else ""
    chapters = [
        Chapter(
            "In short",
            tuple(_paragraphs(findings)),
            (_summary(findings),),
            findings=tuple(in_short(findings)),
        ),
        *(
            chapter
            for number, contactor in enumerate(findings.contactors)
            for chapter in _contactor_chapters(contactor, number, findings)
        ),
        *press_chapters(findings),
        Chapter("Delay and loss", plots=(delays, distribution, loss)),
        Chapter("Clock and loop", plots=(clock, loop)),
        Chapter("What happened", tables=(Table("Events", columns, events, more),)),
    ]
    if findings.contents.about:
        stated = Table(
            "Stated by the person who recorded",
            ("entry", "text"),
            tuple(findings.contents.about.items()),
        )
        chapters.append(Chapter("About the recording", tables=(stated,)))
    if runs := findings.contents.provenance:
        titles = [f"Run {n}" for n in range(1, len(runs) + 1)] if len(runs) > 1 else ["The run"]
        tables = tuple(map(provenance_table, titles, runs))
        chapters.append(Chapter("Provenance of the recording", tables=tables, folded=True))
    return Report(f"Recording {path.name}", tuple(chapters))


def in_short(findings: RunFindings) -> Iterable[str]:
    """Yield at most five sentences: on the recorded span, and the last one on the whole run."""
    summary, own = findings.summary(), findings.contents.summary or Summary()
    samples, felt = summary.samples, summary.availability.felt
    shared = "A pulse was not felt" if felt is None else f"A pulse was felt for {percent(felt)}"
    yield f"{shared} of the {findings.seconds:.1f} s that were recorded."
    delay_ms = summary.playout_delay_ms.mean
    aged = "" if delay_ms is None else f", which was {delay_ms:z.1f} ms old on average"
    if worst := summary.worst_contactor():
        name, aligned_n, figures = worst
        in_phase = NEWTONS.text(figures.force_rmse_n.in_phase)
        of = f" at {name}, the worst contactor," if name else ""
        present = f", and {in_phase} in phase, against the pulse of the same moment"
        yield (
            f"The force RMSE{of} is {NEWTONS.text(aligned_n)} aligned, against the pulse of the"
            f" played instant{aged}{present if in_phase else ''}."
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
    if findings.contents.summary is None:
        yield "The recording has no figures of the display's whole run."
        return
    gap_ms, seconds = own.loop.worst_5s.gap_ms, own.availability.seconds
    length = "" if seconds is None else f" of {seconds:.1f} s"
    longest = "" if gap_ms is None else f"the longest gap was {gap_ms:.0f} ms; "
    broken = interruptions_text(own.to_dict()["interruptions"]) or "none"
    refused = ", ".join(explain_causes(own.rejected)) or "nothing"
    faults = "; ".join(map(str, own.faults)) or "none"
    yield (
        f"In the display's whole run{length}, {longest}interruptions: {broken}; refused: {refused};"
        f" faults: {faults}."
    )


def _paragraphs(findings: RunFindings) -> Iterable[str]:
    begin = datetime.fromtimestamp((findings.contents.begin_ns or 0) // 1_000_000_000, UTC)
    streams = (
        ", ".join(f"“{name}”" for name in dict.fromkeys(findings.contents.streams)) or "no stream"
    )
    yield (
        f"{streams}, {begin:%Y-%m-%d %H:%M:%S} UTC, {findings.seconds:.1f} s,"
        f" {count_text(len(findings.contents.streams), 'session')} of the sensing node."
    )
    for line in findings.contents.gaps:
        yield f"The recording: {line}."
    if findings.runs > 1:
        yield f"The display was started {findings.runs} times; its own figures are of the last run."
    if spans := _spans(findings):
        yield spans


def _spans(findings: RunFindings) -> str:
    """Return which span each column of figures covers, where a status states the run's length."""
    own = findings.contents.summary or Summary()
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
    summaries = findings.summary(), findings.contents.summary or Summary()
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
            rates = [r for _, *ends in contactor.heart if (r := ends[place]) is not None]
            shown = f"{median(rates):.1f} /min" if rates else NONE
            rows.append((f"{of}heart rate at the {name}, median", shown, NONE))
    last = (
        "its final status" if findings.contents.final else "its last status, since it never ended"
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
    contactor: ContactorFindings, number: int, findings: RunFindings
) -> tuple[Chapter, Chapter]:
    """Return the chapters on force and beats; number: of the contactor, from 0."""
    several = len(findings.contactors) > 1
    of, ending = (f" – {contactor.name}", f"-{number + 1}") if several else ("", "")
    words, plots = ["No beat was found in the recorded samples."], list[Plot]()
    if contactor.trends:
        words, plots = [], [with_events(findings, beats_plot(f"beats{ending}", contactor))]
    beats = Chapter(f"Beats{of}", words, plots=plots)
    if contactor.ratio is None or not contactor.first:
        unplayed = "The pulse was never played at its full strength."
        return Chapter(f"Force{of}", (unplayed,)), beats
    plots = [
        force_plot(f"force-first{ending}", "The first seconds at full strength.", contactor.first),
    ]
    if not findings.pressed:
        caption = "Around the largest difference."
        plots.append(force_plot(f"force-worst{ending}", caption, contactor.worst))
        plots.append(error_plot(f"error{ending}", contactor))
    # On a busy host each window may have a gap.
    if any(rate is not None for _, *rates in contactor.heart for rate in rates):
        plots.append(heart_plot(f"heart-rate{ending}", contactor))
    channel, ratio = f"channel {contactor.channel}", contactor.ratio
    reference = (
        f"The felt force is compared with the force of {channel} at the wrist"
        if ratio == 1
        else f"The felt force is compared with {ratio:.4g} times the force of {channel} at"
        " the wrist, so that both strains are equal"
    )
    words = [f"{reference}. It is shown at the instants that were played, as “at the wrist”."]
    if findings.pressed:
        words.append(PRESSED)
    timed = [with_events(findings, plot) for plot in plots]
    return Chapter(f"Force{of}", words, plots=timed), beats


def press_chapters(findings: RunFindings) -> Iterator[Chapter]:
    """Yield the chapter on the press, where the recorded stream has a hold-down."""
    if not len(findings.trends[HELD].t_s):
        return
    words, plots = [], [press_plot(findings)]
    beats = findings.steady_beats
    points = [each.point for each in judge_beats(beats[-MOST_BEATS:])]
    try:
        curve = fit_depth_curve(points)
    except DepthError as error:
        words.append(f"No curve of the pulse's height against the hold-down: {error}.")
        if points:
            plots.append(height_plot(points))
    else:
        largest_mn, best_n = 1e3 * curve.largest_n.value, curve.best_n.value
        words.append(
            f"The pulse is highest, {largest_mn:.0f} mN, at a hold-down of {best_n:.2f} N;"
            f" {len(curve.good)} of {count_text(len(points), 'beat')} at a steady hold-down are"
            " good."
        )
        if curve.at_end:
            words.append(f"{curve.at_end[0].upper()}{curve.at_end[1:]}.")
        plots.append(height_plot(points, curve))
    if len(beats) > MOST_BEATS:
        words.append(f"The curve is of the last {MOST_BEATS} of {len(beats)} beats.")
    yield Chapter("Press and hold-down", tuple(words), plots=tuple(plots))
