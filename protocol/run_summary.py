"""Summary of a run: the same keys from every command and node, null where one does not apply.

To add a figure, add a field here, or to its table in `summary_tables.py` or
`loop_tables.py`.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from protocol.beats import AnnounceFigures, BeatFigures
from protocol.config.quantities import Name, count_text
from protocol.counters import (
    Availability,
    ErrorWindow,
    Interruptions,
    Limits,
    availability_text,
    interruptions_text,
    largest_windows_text,
    limit_texts,
    longest_limit_text,
    windows_text,
)
from protocol.errors import explain_causes
from protocol.figures import (
    COUNT,
    MILLISECONDS,
    NEWTONS,
    RATIO,
    SHARE,
    STRAIN,
    Registry,
    Surface,
    absent,
    figure,
    table,
    texts,
)
from protocol.host.output import write_whole
from protocol.loop_tables import Loop
from protocol.press_figures import PressFigures
from protocol.provenance import Provenance
from protocol.summary_tables import (
    AT_THE_END,
    BY_THE_PAGE,
    IN_ALERTS,
    NOT_RECORDED,
    AlignedErrors,
    Clock,
    Compensation,
    DataConnections,
    FrameCounts,
    OneWayDelay,
    PlayoutDelay,
    Reconnections,
    Roughness,
    SampleCounts,
)

# No figure is larger: clocks at most 292 years apart are 1e13 ms.
LARGEST = 1e15


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures of a run; `protocol.figures` explains their fields."""

    samples: SampleCounts = table(
        SampleCounts, "samples", absent=absent("The page has the share that is lost.", Surface.PAGE)
    )
    frames: FrameCounts = table(FrameCounts, "frames", absent=AT_THE_END)
    data_connections: DataConnections = table(
        DataConnections, "data connections", absent=NOT_RECORDED
    )
    reconnections: Reconnections = table(
        Reconnections, "reconnections", absent=AT_THE_END | NOT_RECORDED
    )
    one_way_delay_ms: OneWayDelay = table(
        OneWayDelay, "one-way delay", MILLISECONDS, "one_way_delay_seconds"
    )
    playout_delay_ms: PlayoutDelay = table(
        PlayoutDelay, "playout delay", MILLISECONDS, "playout_delay_seconds"
    )
    covered_delay_ms: float | None = figure(
        "Mean age of the data behind the felt force: the larger of perceived delay and the newest"
        " sample's age, plus the sensing chain's group delay",
        "{} from the wrist to the force at the finger",
        MILLISECONDS,
        metric="covered_delay_mean_seconds",
        row="covered delay",
        absent=AT_THE_END | absent("A recording has no age of samples.", Surface.REPORT),
    )
    compensation: Compensation = table(Compensation)
    beats: BeatFigures = table(BeatFigures, "pulse")
    announce: AnnounceFigures = table(
        AnnounceFigures,
        "ECG",
        absent=absent("Predictions are those of the display that was recorded.", Surface.REPORT),
    )
    clock: Clock = table(Clock, "clock")
    force_rmse_n: AlignedErrors = table(
        AlignedErrors, "force RMSE", NEWTONS, "force_rmse_newtons", absent=BY_THE_PAGE
    )
    strain_rmse: AlignedErrors = table(
        AlignedErrors,
        "strain RMSE",
        STRAIN,
        "strain_rmse_ratio",
        absent=BY_THE_PAGE,
    )
    within_jnd: float | None = figure(
        "Share of the time judged in which the aligned force error is below 10 % of"
        " the pulse's peak to peak",
        metric="within_jnd_ratio",
        row="within JND",
        unit=SHARE,
        share_of="judged",
        absent=BY_THE_PAGE,
    )
    windows: list[ErrorWindow] = figure(
        "Perceived delay E and force RMSE, aligned and in phase, by time after the first judged"
        " tick: seconds at first, then windows that double; of a display only at its end",
        row="by time",
        show=windows_text,
        absent=AT_THE_END
        | absent("It is no single number.", Surface.METRICS)
        | absent("The plots show the course.", Surface.REPORT),
        factory=list,
    )
    availability: Availability = table(
        Availability,
        "availability",
        show=availability_text,
        headline=lambda shares: SHARE.text(shares.get("felt")),
    )
    interruptions: Interruptions = table(
        Interruptions,
        "interruptions",
        show=interruptions_text,
        headline=lambda known: COUNT.text(known.get("count")),
    )
    roughness: Roughness = table(
        Roughness,
        "above 25 Hz",
        absent=absent("It needs the whole run; the plots show its course.", Surface.PAGE),
    )
    limited: Limits = table(
        Limits,
        "at a limit",
        show=lambda limits: texts(limit_texts(limits), "; "),
        headline=longest_limit_text,
    )
    press: PressFigures = table(PressFigures, "set-points")
    loop: Loop = table(Loop, "loop")
    speed: float | None = figure(
        "Speed of a simulation",
        "{} times real time",
        RATIO._replace(form=".0f"),
        row="speed",
        absent=absent("A simulation is not watched while it runs.", but=Surface.SUMMARY),
    )
    rejected: dict[str, int] = figure(
        "Messages and peers refused, by cause",
        metric="rejected_total",
        row="rejected",
        show=lambda rejected: "\n".join(explain_causes(rejected)) or "nothing",
        headline=lambda rejected: count_text(sum(rejected.values()), "message"),
        label="cause",
        absent=absent("Each cause is an event.", Surface.REPORT),
        factory=dict,
    )
    hardware: dict[str, int] = figure(
        "On a real bench: errors of the links to drive and film that the next message corrected",
        metric="hardware_events_total",
        row="hardware",
        show=lambda counts: texts(f"{n} {name}" for name, n in sorted(counts.items())),
        label="event",
        absent=AT_THE_END | absent("Frequent errors are events.", Surface.REPORT),
        factory=dict,
    )
    faults: list[str] = figure(
        "Faults that safety latched, samples that a real film's sensor missed, and implausible"
        " properties of the source",
        metric="fault",
        row="faults",
        show=lambda faults: "; ".join(faults) or "none",
        label="name",
        absent=IN_ALERTS | absent("Each fault is an event.", Surface.REPORT),
        factory=list,
    )
    waiting_for: str | None = figure(
        "Of a display that waits: what it waits for, or why that does not come; null otherwise",
        row="waiting for",
        show=lambda text: text or None,
        absent=absent("It is shown beside the state.", Surface.PAGE)
        | absent("It is text, and changes with every attempt.", Surface.METRICS)
        | absent("Each gap is an event.", Surface.REPORT),
    )
    finger: str | None = figure(
        "Measured state of the finger in one sentence; without a drive, that of the model",
        metric="finger",
        row="finger",
        show=lambda finger: finger or None,
        label="name",
        absent=absent("It is shown beside the state.", Surface.PAGE)
        | absent("It is the last state; the plots show the course.", Surface.REPORT),
    )
    finger_stiffness: float | None = figure(
        "Finger's stiffness that the observer has learnt, over the scene's"
        " `fingertip`; null until it is learnt",
        "{} times the scene's fingertip",
        RATIO,
        metric="finger_stiffness_ratio",
        row="finger's stiffness",
        absent=IN_ALERTS | absent("A doubtful stiffness is an event.", Surface.REPORT),
    )

    contactors: dict[Name, "Summary"] = figure(
        "Of several contactors, the figures of each: those that are null or empty above, and the"
        " account of the samples",
        absent=absent("Its rows are shown, each with the contactor's name."),
        factory=dict,
    )

    def of_each_contactor(self) -> dict[str, "Summary"]:
        """Return the figures of each contactor by its name; "" is the name of an only one."""
        return self.contactors or {"": self}

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON and msgpack; NaN and numbers beyond `LARGEST` are None."""
        whole = {key: _plain(getattr(self, key)) for key in self.__dataclass_fields__}
        whole["contactors"] = {
            name: {key: _plain(getattr(figures, key)) for key in OF_A_CONTACTOR}
            for name, figures in self.contactors.items()
        }
        return whole


def _plain(value: Any) -> Any:
    """Return a figure in plain types.

    As `dataclasses.asdict` without its copies, which took most of the time of a status.
    """
    if isinstance(value, float):
        return value if abs(value) <= LARGEST else None
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    if dataclasses.is_dataclass(value):
        return {key: _plain(getattr(value, key)) for key in value.__dataclass_fields__}
    return value


# Keys of the figures that each contactor has.
OF_A_CONTACTOR = (
    *("samples", "compensation", "beats", "force_rmse_n", "strain_rmse", "within_jnd", "windows"),
    *("availability", "roughness", "limited", "hardware", "finger", "finger_stiffness"),
)


def contactors_of(summary: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the figures of each contactor in a summary's JSON; "" is the name of an only one."""
    return summary.get("contactors") or {"": summary}


def with_contactors(summary: Summary, contactors: Mapping[str, Summary]) -> Summary:
    """Return a display's summary with the figures of its contactors.

    Those of an only contactor are put at the top level, of several under `contactors`.
    """
    if len(contactors) > 1:
        return replace(summary, contactors=dict(contactors))
    (figures,) = contactors.values()
    of_display = summary.compensation
    compensation = replace(
        figures.compensation,
        predicted=of_display.predicted,
        horizon_ms=of_display.horizon_ms,
        trusted=of_display.trusted,
    )
    keys = (key for key in OF_A_CONTACTOR if key not in ("samples", "availability"))
    changes = {key: getattr(figures, key) for key in keys}
    return replace(summary, **changes | {"compensation": compensation})


# Every figure of a summary, and its rows.
REGISTRY = Registry(Summary)


def write_json(summary: Summary, path: Path, provenance: Provenance | None = None) -> None:
    """Write the summary as JSON, together with its provenance. Raises OutputError."""
    origin = {} if provenance is None else {"provenance": provenance.to_dict()}
    write_whole(path, json.dumps(summary.to_dict() | origin, indent=2) + "\n")


def print_summary(summary: Summary, console: Console) -> None:
    """Print the summary for people, one line for each row that has a value."""
    lines = Table(show_header=False, box=None, pad_edge=False)
    for name, text in rows(summary.to_dict(), Surface.SUMMARY):
        # As Text, because rich would take a [section] in a fault for markup.
        lines.add_row(name, Text(text))
    console.print(lines)


def rows(summary: Mapping[str, Any], surface: Surface) -> list[tuple[str, str]]:
    """Return name and text of each row of a summary's JSON on a surface.

    The rows of several contactors come last, with a line for each. Those of the samples follow the
    display's own.
    """
    found = [(row.name, row.text) for row in REGISTRY.rows(summary, surface)]
    contactors = summary.get("contactors", {})
    lines: dict[str, list[str]] = {}
    for name, figures in contactors.items():
        # One line for all contactors, below.
        alone = {**figures, "windows": []}
        for row in REGISTRY.rows(alone, surface):
            lines.setdefault(row.name, []).append(f"{name}: {row.text}")
    found = [(name, "\n".join([text, *lines.pop(name, [])])) for name, text in found]
    found += [(name, "\n".join(texts)) for name, texts in lines.items()]
    windows = [figures.get("windows", []) for figures in contactors.values()]
    by_time = largest_windows_text(windows) if surface is Surface.SUMMARY and windows else None
    return [*found, ("by time", by_time)] if by_time else found
