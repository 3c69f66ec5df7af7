"""The report of a recording: its chapters in their order."""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from protocol.config.quantities import count_text
from protocol.figures import Surface
from protocol.run_summary import REGISTRY, Summary
from telepulse.recording.report.findings import RunFindings, read_findings
from telepulse.reports.document import Chapter, Report, Table, provenance_table

if TYPE_CHECKING:
    from telepulse.reports.document import Plot

NONE = "–"
LEVELS = {2: "", 3: "warning", 4: "error"}


def build_recording_report(path: Path) -> Report:
    """Read a recording and report it. Raises SourceError."""
    findings = read_findings(path)
    chapters = (
        _whole(findings),
        _force(findings),
        _delays(findings),
        _clock_and_loop(findings),
        _events(findings),
        *_provenance(findings),
    )
    return Report(f"Recording {path.name}", chapters)


def _whole(findings: RunFindings) -> Chapter:
    begin = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(
        microseconds=(findings.begin_ns or 0) // 1000
    )
    streams = ", ".join(f"“{name}”" for name in dict.fromkeys(findings.streams)) or "no stream"
    paragraphs = [
        f"{streams}, {begin:%Y-%m-%d %H:%M:%S} UTC, {findings.seconds:.1f} s,"
        f" {count_text(len(findings.streams), 'session')} of the sensing node."
    ]
    paragraphs += [f"The recording: {line}." for line in findings.gaps]
    if findings.runs > 1:
        paragraphs.append(
            f"The display was started {findings.runs} times; its own figures are of the last run."
        )
    own_ticks = None if findings.own is None else findings.own.loop.ticks
    if findings.runs == 1 and own_ticks is not None and own_ticks > findings.ticks:
        paragraphs.append(
            f"The display's own figures count {count_text(own_ticks - findings.ticks, 'tick')} more"
            " than were recorded: from before the recording, or missed by the recorder."
        )
    return Chapter("In short", tuple(paragraphs), (_summary(findings),))


def _summary(findings: RunFindings) -> Table:
    recorded, own = (
        REGISTRY.cells(summary.to_dict(), Surface.REPORT)
        for summary in (findings.summary(), findings.own or Summary())
    )
    rows = [(name, recorded[name] or NONE, own[name] or NONE) for name in recorded]
    for place, name in enumerate(("wrist", "finger")):
        rates = [rate for _, *both in findings.forces.heart if (rate := both[place]) is not None]
        shown = f"{median(rates):.1f} /min" if rates else NONE
        rows.append((f"heart rate at the {name}, median", shown, NONE))
    last = "its final status" if findings.own_final else "its last status, since it never ended"
    return Table(
        "the run",
        ("", "from the recording", "the display's own"),
        tuple(row for row in rows if row[1:] != (NONE, NONE)),
        note=f"Its own: by {last}. From the recording: computed from frames, clock replies and"
        " ticks with the display's own modules. A tick is recorded with when it was due, not when"
        " it began: what came in between counts as late there. Ticks missed before the first one"
        " and a loss after the last frame are not seen.",
    )


def _force(findings: RunFindings) -> Chapter:
    from telepulse.recording.report import plots

    forces = findings.forces
    alignment = forces.alignment
    if alignment.ratio is None or not forces.first:
        return Chapter("Force", ("The pulse was never played at its full strength.",))
    drawn: list[Plot] = [
        plots.stretch("force-first", "The first seconds at full strength.", forces.first),
        plots.stretch("force-worst", "Around the largest difference.", forces.worst),
        plots.error(forces),
    ]
    if forces.heart:
        drawn.append(plots.heart(forces))
    found = (
        f"The force at the finger should be {alignment.ratio:.4g} times that of channel"
        f" {alignment.channel}. The wrist's force is shown times that ratio, at the instants that"
        " were played."
    )
    return Chapter("Force", (found,), plots=tuple(drawn))


def _delays(findings: RunFindings) -> Chapter:
    from telepulse.recording.report import plots

    drawn = (
        plots.delays(findings),
        plots.delay_distribution(findings),
        plots.loss(findings),
    )
    return Chapter("Delay and loss", plots=drawn)


def _clock_and_loop(findings: RunFindings) -> Chapter:
    from telepulse.recording.report import plots

    return Chapter("Clock and loop", plots=(plots.clock(findings), plots.loop(findings)))


def _events(findings: RunFindings) -> Chapter:
    rows = tuple(
        (f"{t_s:.2f}", LEVELS.get(level, str(level)), name, text)
        for t_s, level, name, text in findings.events
    )
    more = f"{findings.more_events} further ones are not shown." if findings.more_events else ""
    return Chapter("What happened", tables=(Table("events", ("s", "", "what", ""), rows, more),))


def _provenance(findings: RunFindings) -> Iterator[Chapter]:
    """Yield what produced the recording, where it has it: those of older versions do not."""
    if findings.provenance:
        tables = tuple(
            provenance_table(f"run {number}" if len(findings.provenance) > 1 else "the run", run)
            for number, run in enumerate(findings.provenance, 1)
        )
        yield Chapter("Provenance of the recording", tables=tables)
