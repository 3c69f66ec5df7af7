"""The summary every command and node ends with: the same keys everywhere, null where a thing
does not apply."""

import dataclasses
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from protocol.availability import (
    Availability,
    Interruptions,
    availability_text,
    interruptions_text,
    part_text,
)
from protocol.config.quantities import count_text
from protocol.errors import explain_causes
from protocol.histogram import bound
from protocol.host.result_files import write_whole
from protocol.limits import Limits, limit_texts
from protocol.provenance import Provenance

# Stands in a row's text for a value that there is none of; no fault's text has it.
_ABSENT = "\0"
# No figure is larger: clocks at most 292 years apart are 1e13 ms.
LARGEST = 1e15


@dataclass(frozen=True, slots=True)
class SampleCounts:
    """sent = played + late + lost. Played: in the buffer when its instant was played; late:
    arrived after that; lost: never arrived. `before_joining`: sent before a display listened."""

    sent: int | None = None
    played: int | None = None
    late: int | None = None
    lost: int | None = None
    before_joining: int | None = None


@dataclass(frozen=True, slots=True)
class OneWayDelay:
    """Time on the network of a frame's last sample, in ms. Here and below, beyond: the quantiles
    that are beyond what is counted, of which the figure is a lower bound."""

    p50: float | None = None
    p99: float | None = None
    max: float | None = None
    beyond: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class PlayoutDelay:
    """Perceived delay E from the wrist's instant to its playing, in ms."""

    mean: float | None = None
    p99: float | None = None
    beyond: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Compensation:
    """Shares of the time played (`Availability.played`): `predicted`, no sample was there yet of
    what was felt; `trusted`, the predictor was trusted with all of the delay (none where it has no
    say)."""

    predicted: float | None = None
    trusted: float | None = None


@dataclass(frozen=True, slots=True)
class Clock:
    """The sensing clock against the display's. Uncertainty: of the offset, where the ways there
    and back differ by chance alone; asymmetry: what it may be off besides, if one always takes
    longer. Steps: how often either clock has jumped."""

    offset_ms: float | None = None
    skew_ppm: float | None = None
    uncertainty_ms: float | None = None
    asymmetry_ms: float | None = None
    steps: int | None = None


@dataclass(frozen=True, slots=True)
class AlignedErrors:
    """RMSE against the pulse as it was when sampled (aligned) and at that very instant."""

    aligned: float | None = None
    in_phase: float | None = None


@dataclass(frozen=True, slots=True)
class Roughness:
    """The part above 25 Hz, where touch is keenest: RMS in N of the force felt and of what was
    sensed at the same instants, and the ratio of their energies."""

    felt_n: float | None = None
    sensed_n: float | None = None
    energy_ratio: float | None = None


@dataclass(frozen=True, slots=True)
class TickTime:
    """Cost of a tick in µs."""

    p50: float | None = None
    p99: float | None = None
    beyond: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Lateness:
    """The lateness of ticks at their beginning, in µs."""

    p50: float | None = None
    p99: float | None = None
    p999: float | None = None
    max: float | None = None
    beyond: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Deadlines:
    """Share of the ticks of 5 s that were missed, and the longest time between two ticks in ms."""

    missed: float | None = None
    gap_ms: float | None = None


@dataclass(frozen=True, slots=True)
class Loop:
    """The node's loop. late: the deadline alarm is on, because more than 1 % of the ticks of the
    last 5 s were missed or a gap was longer than the drive's watchdog. last_5s: at the time of the
    summary; worst_5s: of the whole run. realtime: measures that were asked for and granted."""

    ticks: int | None = None
    deadline_misses: int | None = None
    tick_us: TickTime = field(default_factory=TickTime)
    late_us: Lateness = field(default_factory=Lateness)
    late: bool | None = None
    last_5s: Deadlines = Deadlines()
    worst_5s: Deadlines = Deadlines()
    realtime: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Frames taken, how many of them came after a later one, and copies over further paths.

    first: where there are several addresses, how many came first over each of them.
    """

    received: int | None = None
    reordered: int | None = None
    copies: int | None = None
    first: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Reconnections:
    """Connections made while one was silent. opened: second ones beside it, for frames; kept: how
    many of them delivered first and took its place; control: those for control messages."""

    opened: int | None = None
    kept: int | None = None
    control: int | None = None


@dataclass(frozen=True, slots=True)
class Summary:
    """See docs/telemetry.md for each key."""

    samples: SampleCounts = SampleCounts()
    frames: FrameCounts = field(default_factory=FrameCounts)
    reconnections: Reconnections = Reconnections()
    one_way_delay_ms: OneWayDelay = field(default_factory=OneWayDelay)
    playout_delay_ms: PlayoutDelay = field(default_factory=PlayoutDelay)
    covered_delay_ms: float | None = None
    compensation: Compensation = Compensation()
    clock: Clock = Clock()
    force_rmse_n: AlignedErrors = AlignedErrors()
    strain_rmse: AlignedErrors = AlignedErrors()
    within_jnd: float | None = None
    availability: Availability = field(default_factory=Availability)
    interruptions: Interruptions = field(default_factory=Interruptions)
    roughness: Roughness = Roughness()
    limited: Limits = field(default_factory=Limits)
    loop: Loop = field(default_factory=Loop)
    speed: float | None = None
    rejected: dict[str, int] = field(default_factory=dict)
    hardware: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    finger: str | None = None
    finger_stiffness: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON and msgpack; what is no figure (NaN, infinite, beyond
        `LARGEST`) becomes None."""
        table: dict[str, Any] = _measured(dataclasses.asdict(self))
        return table


def write_json(summary: Summary, path: Path, provenance: Provenance | None = None) -> None:
    """Write the summary as JSON, with what produced it beside it. Raises OutputError."""
    origin = {} if provenance is None else {"provenance": provenance.to_dict()}
    write_whole(path, json.dumps(summary.to_dict() | origin, indent=2) + "\n")


def print_summary(summary: Summary, title: str, console: Console) -> None:
    """Print the summary for people, one line a row; a row without a value is left out."""
    table = Table(
        title=escape(title), show_header=False, title_justify="left", box=None, pad_edge=False
    )
    for name, text in _rows(summary):
        if _ABSENT not in text:
            # As Text, for a fault may name a [section], which is markup to rich.
            table.add_row(name, Text(text))
    console.print(table)


def _rows(s: Summary) -> list[tuple[str, str]]:
    return [
        (
            "samples",
            f"{_n(s.samples.sent)} sent"
            if s.samples.played is None
            else f"{_n(s.samples.sent)} sent = {_n(s.samples.played)} played"
            f" + {_n(s.samples.late)} late + {_n(s.samples.lost)} lost",
        ),
        (
            "before joining",
            f"{_count(s.samples.before_joining, 'sample')} sent before a display listened",
        ),
        (
            "frames",
            f"{_n(s.frames.received)} received, {_n(s.frames.reordered)} out of order"
            + (f", {s.frames.copies} copies over further paths" if s.frames.copies else "")
            + "".join(f", {count} first over {name}" for name, count in s.frames.first.items()),
        ),
        (
            "reconnections",
            f"{_n(s.reconnections.opened)} opened beside a silent connection for frames,"
            f" {_n(s.reconnections.kept)} of them kept; {_n(s.reconnections.control)} for control"
            if any(dataclasses.astuple(s.reconnections))
            else _ABSENT,
        ),
        (
            "one-way delay",
            f"{_quantile(s.one_way_delay_ms, 'p50')} ms, {_quantile(s.one_way_delay_ms, 'p99')} ms,"
            f" max {_f(s.one_way_delay_ms.max)} ms",
        ),
        (
            "playout delay",
            f"mean {_f(s.playout_delay_ms.mean)} ms, {_quantile(s.playout_delay_ms, 'p99')} ms",
        ),
        ("covered delay", f"{_f(s.covered_delay_ms)} ms from the wrist to the force at the finger"),
        (
            "predicted",
            f"{_f(_percent(s.compensation.predicted))} % of"
            f" {part_text(s.availability.played)} that was played",
        ),
        (
            "predictor",
            f"trusted with all of the delay {_f(_percent(s.compensation.trusted))} % of"
            f" {part_text(s.availability.played)} that was played",
        ),
        (
            "clock",
            f"offset {_f(s.clock.offset_ms, 3)} ± {_f(s.clock.uncertainty_ms, 3)} ms,"
            f" skew {_f(s.clock.skew_ppm, 1)} ppm"
            + (f", steps {s.clock.steps}" if s.clock.steps else ""),
        ),
        (
            "force RMSE",
            f"aligned {_f(_milli(s.force_rmse_n.aligned), 3)} mN,"
            f" in phase {_f(_milli(s.force_rmse_n.in_phase), 3)} mN",
        ),
        (
            "strain RMSE",
            f"aligned {_e(s.strain_rmse.aligned)}, in phase {_e(s.strain_rmse.in_phase)}",
        ),
        ("availability", availability_text(dataclasses.asdict(s.availability)) or _ABSENT),
        ("interrupted", interruptions_text(dataclasses.asdict(s.interruptions)) or _ABSENT),
        (
            "within JND",
            f"{_f(_percent(s.within_jnd))} % of"
            f" {part_text(s.availability.judged)} that could be judged",
        ),
        (
            "above 25 Hz",
            f"{_f(_milli(s.roughness.felt_n), 3)} mN felt, {_f(_milli(s.roughness.sensed_n), 3)} mN"
            f" sensed: energy {_f(s.roughness.energy_ratio, 2)} times",
        ),
        ("limited", "; ".join(limit_texts(dataclasses.asdict(s.limited))) or _ABSENT),
        (
            "loop",
            f"{_count(s.loop.ticks, 'tick')},"
            f" {_count(s.loop.deadline_misses, 'deadline miss', 'deadline misses')}",
        ),
        (
            "worst 5 s",
            f"{_f(_percent(s.loop.worst_5s.missed), 2)} % of the ticks missed,"
            f" longest gap {_f(s.loop.worst_5s.gap_ms, 0)} ms",
        ),
        (
            "tick",
            f"{_quantile(s.loop.tick_us, 'p50', 0)} µs, {_quantile(s.loop.tick_us, 'p99', 0)} µs",
        ),
        (
            "tick began",
            f"{_quantile(s.loop.late_us, 'p50', 0)} µs late,"
            f" {_quantile(s.loop.late_us, 'p99', 0)} µs,"
            f" {_quantile(s.loop.late_us, 'p999', 0)} µs, max {_f(s.loop.late_us.max, 0)} µs",
        ),
        ("real-time", ", ".join(s.loop.realtime) or _ABSENT),
        ("speed", f"{_f(s.speed, 0)} times real time"),
        ("rejected", "\n".join(explain_causes(s.rejected)) or "nothing"),
        ("hardware", _counts(s.hardware) or _ABSENT),
        ("faults", "; ".join(s.faults) or "none"),
        ("finger", s.finger or _ABSENT),
        ("finger's stiffness", f"{_f(s.finger_stiffness, 2)} times the scene's fingertip"),
    ]


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))


def _n(value: int | None) -> str:
    return _ABSENT if value is None else str(value)


def _count(value: int | None, singular: str, plural: str | None = None) -> str:
    return _ABSENT if value is None else count_text(value, singular, plural)


def _quantile(
    table: OneWayDelay | PlayoutDelay | TickTime | Lateness, key: str, digits: int = 1
) -> str:
    """Return a quantile with its name, as "p99 > 5000" where it is beyond what is counted."""
    name = "p99.9" if key == "p999" else key
    return f"{name} {bound(key, table.beyond)}{_f(getattr(table, key), digits)}"


def _f(value: float | None, digits: int = 1) -> str:
    return _ABSENT if value is None or math.isnan(value) else f"{value:.{digits}f}"


def _e(value: float | None) -> str:
    return _ABSENT if value is None or math.isnan(value) else f"{value:.3e}"


def _milli(value: float | None) -> float | None:
    return None if value is None else value * 1e3


def _percent(value: float | None) -> float | None:
    return None if value is None else value * 100


def _measured(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _measured(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_measured(inner) for inner in value]
    return None if isinstance(value, float) and not abs(value) <= LARGEST else value
