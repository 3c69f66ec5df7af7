"""Fields of a run's summary: the same keys from every command and node, null where none applies.

Each field has an entry in `figures.toml`, which says what it means.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Final

from pydantic import TypeAdapter

from protocol.config.quantities import Name
from protocol.faults import Fault, Note, records_of_texts
from protocol.finger import FingerState
from protocol.refusals import Reason

# No figure is larger: clocks at most 292 years apart are 1e13 ms.
LARGEST: Final = 1e15
# Keys of `Availability` that are shares by state, and add up to 1 with `missed`.
STATES: Final = ("felt", "starting", "stale", "faulted", "waiting", "ended", "missed")


@dataclass(frozen=True, slots=True)
class SampleCounts:
    """sent = played + predicted + late + lost.

    A lost sample that comes after all counts as predicted or late.
    """

    sent: int | None = None
    played: int | None = None
    predicted: int | None = None
    late: int | None = None
    lost: int | None = None
    before_joining: int | None = None


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Frames of the stream as they arrived."""

    received: int | None = None
    reordered: int | None = None
    copies: int | None = None
    first: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DataConnections:
    """Parallel connections for frames."""

    open: int | None = None


@dataclass(frozen=True, slots=True)
class Reconnections:
    """Connections made while one was silent."""

    opened: int | None = None
    kept: int | None = None
    control: int | None = None


@dataclass(frozen=True, slots=True)
class OneWayDelay:
    """Time on the network of a frame's last sample."""

    p50: float | None = None
    p99: float | None = None
    max: float | None = None
    beyond: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class PlayoutDelay:
    """Perceived delay E from the wrist's instant to its playing."""

    mean: float | None = None
    p99: float | None = None
    beyond: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Compensation:
    """Use and quality of the prediction; shares are of the time played (`Availability.played`)."""

    predicted: float | None = None
    horizon_ms: float | None = None
    trusted: float | None = None
    error_n: float | None = None
    error_share: float | None = None
    corrections: int | None = None
    corrections_per_min: float | None = None
    noticed_5s: float | None = None
    alarm: bool | None = None


@dataclass(frozen=True, slots=True)
class BeatFigures:
    """Figures of the received pulse; medians are over the last minute of good beats."""

    count: int | None = None
    rate_per_min: float | None = None
    variability_ms: float | None = None
    height_n: float | None = None
    height_at_finger_n: float | None = None
    upstroke_ms: float | None = None
    notch_ms: float | None = None
    quality: float | None = None
    doubtful: float | None = None
    alarm: bool | None = None


@dataclass(frozen=True, slots=True)
class AnnounceFigures:
    """Figures of an ECG that announces the beats; of a stream without one, all are null."""

    r_waves: int | None = None
    used: float | None = None
    unused: str | None = None
    transit_ms: float | None = None
    deviation_ms: float | None = None


@dataclass(frozen=True, slots=True)
class Clock:
    """The sensing clock against the display's."""

    offset_ms: float | None = None
    skew_ppm: float | None = None
    uncertainty_ms: float | None = None
    asymmetry_ms: float | None = None
    steps: int | None = None


@dataclass(frozen=True, slots=True)
class RmsErrors:
    """RMSE of the felt force, or of its strain, against the pulse."""

    aligned: float | None = None
    in_phase: float | None = None


@dataclass(frozen=True, slots=True)
class ErrorWindow:
    """Errors in a part of the run, and its times in s after the first tick at full strength.

    playout_delay_ms: mean perceived delay E. aligned_n, in_phase_n: RMS error in N.
    """

    from_s: float
    to_s: float
    playout_delay_ms: float
    aligned_n: float | None = None
    in_phase_n: float | None = None


@dataclass(frozen=True, slots=True)
class Availability:
    """Length of the run, and shares of it. Those by state, and `missed`, add up to 1."""

    seconds: float | None = None
    felt: float | None = None
    starting: float | None = None
    stale: float | None = None
    faulted: float | None = None
    waiting: float | None = None
    ended: float | None = None
    missed: float | None = None
    played: float | None = None
    judged: float | None = None


@dataclass(frozen=True, slots=True)
class Interruptions:
    """Ended interruptions: from the last full-strength tick before to the first one after it."""

    count: int | None = None
    seconds: float | None = None
    longest_s: float | None = None
    began_s: float | None = None
    ended_s: float | None = None


@dataclass(frozen=True, slots=True)
class Roughness:
    """The part above 25 Hz, where touch is most sensitive."""

    felt_n: float | None = None
    sensed_n: float | None = None
    energy_ratio: float | None = None


@dataclass(frozen=True, slots=True)
class Limited:
    """Figures of one limit; None where the limit does not apply."""

    times: int | None = None
    seconds: float | None = None
    share: float | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """Figures of each limit.

    `ForceBounds` applies the first three to the target force. force: the force limit. negative: the
    bound at 0 N, counted where the target is more than 1 mN below it. slew: the slew limit at full
    strength, without ramps and fades. travel: the end of the actuator's travel towards the finger,
    on a real bench with the braking before it. film: the ADC range of the modelled film. adc: that
    of the sensing node.
    """

    force: Limited = field(default_factory=Limited)
    negative: Limited = field(default_factory=Limited)
    slew: Limited = field(default_factory=Limited)
    travel: Limited = field(default_factory=Limited)
    film: Limited = field(default_factory=Limited)
    adc: Limited = field(default_factory=Limited)


@dataclass(frozen=True, slots=True)
class SetPointCounts:
    """sent = applied + superseded + lost.

    At the wrist, those after the newest one that arrived are not known, and not counted as sent.
    """

    sent: int | None = None
    applied: int | None = None
    superseded: int | None = None
    lost: int | None = None


@dataclass(frozen=True, slots=True)
class PressFigures(SetPointCounts):
    """The account of the set-points, and the state of the press."""

    press_n: float | None = None
    hold_down_n: float | None = None
    loop_gain: float | None = None
    probe: str | None = None


@dataclass(frozen=True, slots=True)
class TickTime:
    """Time of a part of a tick."""

    p50: float | None = None
    p99: float | None = None
    beyond: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Lateness:
    """Lateness of ticks at their beginning."""

    p50: float | None = None
    p99: float | None = None
    p999: float | None = None
    max: float | None = None
    beyond: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Deadlines:
    """Missed ticks and longest gap within 5 s."""

    missed: float | None = None
    gap_ms: float | None = None


@dataclass(frozen=True, slots=True)
class Loop:
    """The node's loop."""

    ticks: int | None = None
    deadline_misses: int | None = None
    command_us: TickTime = field(default_factory=TickTime)
    tick_us: TickTime = field(default_factory=TickTime)
    late_us: Lateness = field(default_factory=Lateness)
    late: bool | None = None
    last_5s: Deadlines = field(default_factory=Deadlines)
    worst_5s: Deadlines = field(default_factory=Deadlines)
    realtime: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures of a run."""

    samples: SampleCounts = field(default_factory=SampleCounts)
    frames: FrameCounts = field(default_factory=FrameCounts)
    data_connections: DataConnections = field(default_factory=DataConnections)
    reconnections: Reconnections = field(default_factory=Reconnections)
    one_way_delay_ms: OneWayDelay = field(default_factory=OneWayDelay)
    playout_delay_ms: PlayoutDelay = field(default_factory=PlayoutDelay)
    covered_delay_ms: float | None = None
    compensation: Compensation = field(default_factory=Compensation)
    beats: BeatFigures = field(default_factory=BeatFigures)
    announce: AnnounceFigures = field(default_factory=AnnounceFigures)
    clock: Clock = field(default_factory=Clock)
    force_rmse_n: RmsErrors = field(default_factory=RmsErrors)
    strain_rmse: RmsErrors = field(default_factory=RmsErrors)
    within_jnd: float | None = None
    windows: list[ErrorWindow] = field(default_factory=list)
    availability: Availability = field(default_factory=Availability)
    interruptions: Interruptions = field(default_factory=Interruptions)
    roughness: Roughness = field(default_factory=Roughness)
    limited: Limits = field(default_factory=Limits)
    press: PressFigures = field(default_factory=PressFigures)
    loop: Loop = field(default_factory=Loop)
    speed: float | None = None
    rejected: dict[str, int] = field(default_factory=dict)
    rejected_readers: dict[str, int] = field(default_factory=dict)
    hardware: dict[str, int] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    refused: str | None = None
    waiting_for: list[Reason] = field(default_factory=list)
    finger: FingerState = field(default_factory=FingerState)
    finger_stiffness: float | None = None
    contactors: dict[Name, "Summary"] = field(default_factory=dict)

    def of_each_contactor(self) -> dict[str, "Summary"]:
        """Return the figures of each contactor by its name; "" is the name of an only one."""
        return self.contactors or {"": self}

    def worst_contactor(self) -> "tuple[str, float, Summary] | None":
        """Return name, aligned force RMSE in N and figures of the contactor with the largest one.

        Where one of several contactors stands for all: verdict, and a report's first sentences. A
        display reports the largest error alone to its sensing node. The page shows the contactor
        that a person chooses, `Run` the first one; all else has each by its name.
        """
        errors = [
            (name, error_n, figures)
            for name, figures in self.of_each_contactor().items()
            if (error_n := figures.force_rmse_n.aligned) is not None
        ]
        return max(errors, key=lambda each: each[1], default=None)

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
    if isinstance(value, StrEnum):
        return value.value
    if isinstance(value, Fault):
        return value.to_dict()
    if dataclasses.is_dataclass(value):
        return {key: _plain(getattr(value, key)) for key in value.__dataclass_fields__}
    return value


_SUMMARY = TypeAdapter(Summary)


def read_summary(plain: Any) -> Summary:
    """Return a summary from its JSON, also from that of a version without records of faults.

    Raises ValidationError.
    """
    if isinstance(plain, dict) and "notes" not in plain:
        plain = _with_records(plain)
    return _SUMMARY.validate_python(plain)


def _with_records(plain: dict[str, Any]) -> dict[str, Any]:
    """Return the summary of an earlier version.

    There faults and what is awaited were texts, and so was the state of the finger, of which
    nothing is taken.
    """
    changed, texts, awaited = dict(plain), plain.get("faults"), plain.get("waiting_for")
    if isinstance(texts, list) and all(isinstance(each, str) for each in texts):
        changed["faults"], changed["notes"] = records_of_texts(texts)
    if awaited is None or isinstance(awaited, str):
        changed["waiting_for"] = [Reason(awaited)] if awaited else []
    contactors = plain.get("contactors")
    if isinstance(contactors, dict):
        changed["contactors"] = {name: _fingerless(each) for name, each in contactors.items()}
    whole: dict[str, Any] = _fingerless(changed)
    return whole


def _fingerless(figures: Any) -> Any:
    if not isinstance(figures, dict) or not isinstance(figures.get("finger"), str | None):
        return figures
    return {key: value for key, value in figures.items() if key != "finger"}


def awaited_in(summary: Mapping[str, Any]) -> list[Reason]:
    """Return what a display waits for, from a summary's JSON."""
    return [Reason(each["text"], each["further"]) for each in summary.get("waiting_for", ())]


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
    availability = replace(summary.availability, judged=figures.availability.judged)
    changes = {key: getattr(figures, key) for key in OF_A_CONTACTOR if key != "samples"}
    changes |= {"compensation": compensation, "availability": availability}
    return replace(summary, **changes)


def with_sensing_node(display: Summary, sensing: Summary) -> Summary:
    """Return a display's summary with the faults, notes and ADC's range of its sensing node.

    What a fault of the sensing node is about is the probe at the wrist.
    """
    return replace(
        display,
        limited=replace(display.limited, adc=sensing.limited.adc),
        faults=[*display.faults, *(replace(each, contactor="probe") for each in sensing.faults)],
        notes=[*display.notes, *sensing.notes],
    )
