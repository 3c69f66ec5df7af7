"""Table of the summary's figures as metrics: Prometheus's names and base units."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from protocol.availability import NAMES as AVAILABILITY
from protocol.limits import NAMES

MS, US, PPM = 1e-3, 1e-6, 1e-6


class MetricKind(Enum):
    """Prometheus's kinds. A summary's quantiles are of all the node's life."""

    COUNTER = "counter"
    GAUGE = "gauge"
    SUMMARY = "summary"


@dataclass(frozen=True, slots=True)
class MetricFigure:
    """A number at `key` of a summary, or a table of counts there, of which `label` tells the names.

    scale: from the summary's unit to the base unit.
    """

    name: str
    kind: MetricKind
    key: str
    help: str = ""
    scale: float = 1.0
    labels: Mapping[str, str] = field(default_factory=dict)
    label: str = ""


def _count(name: str, key: str, help: str, **labels: str) -> MetricFigure:
    return MetricFigure(name, MetricKind.COUNTER, key, help, 1, labels)


def _counts(name: str, key: str, help: str, label: str) -> MetricFigure:
    return MetricFigure(name, MetricKind.COUNTER, key, help, 1, {}, label)


def _gauge(name: str, key: str, help: str = "", scale: float = 1.0, **labels: str) -> MetricFigure:
    return MetricFigure(name, MetricKind.GAUGE, key, help, scale, labels)


def _quantiles(name: str, table: str, help: str, scale: float, **keys: str) -> list[MetricFigure]:
    return [
        MetricFigure(name, MetricKind.SUMMARY, f"{table}.{key}", help, scale, {"quantile": share})
        for key, share in keys.items()
    ]


# The first of a name has its help. A lost sample that comes after all is late, no longer lost, and
# a frame out of turn may move the begin: those two fall, so they are gauges.
FIGURES = [
    _count("samples_sent", "samples.sent", "Samples sent; at a display, since it joined."),
    _count("samples", "samples.played", "Samples that have arrived.", outcome="played"),
    _count("samples", "samples.late", outcome="late", help=""),
    _gauge("samples_lost", "samples.lost", "Samples that have not arrived: sent - played - late."),
    _gauge("samples_before_joining", "samples.before_joining", "Samples sent before joining."),
    _count("frames", "frames.received", "Frames taken."),
    _count("frames_reordered", "frames.reordered", "Frames that came after a later one."),
    _count("frame_copies", "frames.copies", "Copies of frames over further paths."),
    _counts("frames_first", "frames.first", "Frames whose first copy came over a path.", "path"),
    _count(
        "reconnections",
        "reconnections.opened",
        "Connections made while one was silent.",
        kind="second",
    ),
    _count("reconnections", "reconnections.kept", kind="kept", help=""),
    _count("reconnections", "reconnections.control", kind="control", help=""),
    *_quantiles(
        "one_way_delay_seconds",
        "one_way_delay_ms",
        "Time on the network of a frame's last sample.",
        MS,
        p50="0.5",
        p99="0.99",
    ),
    _gauge("one_way_delay_max_seconds", "one_way_delay_ms.max", "Longest one-way delay.", MS),
    *_quantiles(
        "playout_delay_seconds",
        "playout_delay_ms",
        "Perceived delay, from the wrist's instant to its playing.",
        MS,
        p99="0.99",
    ),
    _gauge("finger_stiffness_ratio", "finger_stiffness", "Learnt stiffness by the scene's."),
    _gauge("playout_delay_mean_seconds", "playout_delay_ms.mean", "Mean perceived delay.", MS),
    _gauge(
        "covered_delay_mean_seconds",
        "covered_delay_ms",
        "Mean of the larger of perceived delay and the newest sample's age.",
        MS,
    ),
    *(
        _gauge("availability_ratio", f"availability.{key}", "Share of the run.", state=key)
        for key in AVAILABILITY
    ),
    _gauge("run_seconds", "availability.seconds", "Time of the run, missed ticks included."),
    _gauge("played_ratio", "availability.played", "Share of the run in which a pulse was played."),
    _gauge("judged_ratio", "availability.judged", "Share of the run that could be judged."),
    _count("interruptions", "interruptions.count", help="Interruptions of the pulse."),
    _gauge("interrupted_seconds", "interruptions.seconds", "Time of all interruptions."),
    _gauge("longest_interruption_seconds", "interruptions.longest_s", "The longest of them."),
    _gauge("predicted_ratio", "compensation.predicted", "Share predicted, of the time played."),
    _gauge("trusted_ratio", "compensation.trusted", "Share trusted, of the time played."),
    _gauge("clock_offset_seconds", "clock.offset_ms", "Sensing clock minus display clock.", MS),
    _gauge("clock_skew_ratio", "clock.skew_ppm", "How much faster the sensing clock runs.", PPM),
    _gauge("clock_uncertainty_seconds", "clock.uncertainty_ms", "Of the offset, by chance.", MS),
    _gauge("clock_asymmetry_seconds", "clock.asymmetry_ms", "Of the offset, at most besides.", MS),
    _count("clock_steps", "clock.steps", "How often a clock has jumped."),
    _gauge(
        "force_rmse_newtons",
        "force_rmse_n.aligned",
        "Felt against what should be felt.",
        against="aligned",
    ),
    _gauge("force_rmse_newtons", "force_rmse_n.in_phase", against="in_phase"),
    _gauge(
        "strain_rmse_ratio",
        "strain_rmse.aligned",
        "As the force, of the rubber's strain.",
        against="aligned",
    ),
    _gauge("strain_rmse_ratio", "strain_rmse.in_phase", against="in_phase"),
    _gauge("within_jnd_ratio", "within_jnd", "Share without a felt error, of the time judged."),
    _gauge("roughness_newtons", "roughness.felt_n", "RMS of force above 25 Hz.", force="felt"),
    _gauge("roughness_newtons", "roughness.sensed_n", force="sensed"),
    _gauge("roughness_energy_ratio", "roughness.energy_ratio", "Felt to sensed, above 25 Hz."),
    *(
        _count("limited", f"limited.{limit}.times", "How often a limit was reached.", limit=limit)
        for limit in NAMES
    ),
    *(
        _count("limited_seconds", f"limited.{limit}.seconds", "Time at a limit.", limit=limit)
        for limit in NAMES
    ),
    _count("ticks", "loop.ticks", "Ticks of the loop."),
    _count("deadline_misses", "loop.deadline_misses", "Ticks that began a period late or more."),
    *_quantiles("tick_seconds", "loop.tick_us", "Cost of a tick.", US, p50="0.5", p99="0.99"),
    *_quantiles(
        "tick_lateness_seconds",
        "loop.late_us",
        "How late ticks began.",
        US,
        p50="0.5",
        p99="0.99",
        p999="0.999",
    ),
    _gauge("tick_lateness_max_seconds", "loop.late_us.max", "The latest begin of a tick.", US),
    _gauge("deadline_alarm", "loop.late", "1: above 1 % missed in 5 s, or too long a gap."),
    _gauge("deadline_missed_ratio", "loop.last_5s.missed", "Share of ticks missed.", over="5s"),
    _gauge("deadline_missed_ratio", "loop.worst_5s.missed", over="worst_5s"),
    _gauge("tick_gap_seconds", "loop.last_5s.gap_ms", "Longest gap of ticks.", MS, over="5s"),
    _gauge("tick_gap_seconds", "loop.worst_5s.gap_ms", "", MS, over="worst_5s"),
    _counts("rejected", "rejected", "Messages and peers refused.", "cause"),
    _counts(
        "hardware_events", "hardware", "What went wrong at the bench and was made good.", "event"
    ),
]
# What a summary says besides; faults are words (`families`).
NOT_FIGURES = {
    *("speed", "loop.realtime", "faults", "finger"),
    *("interruptions.began_s", "interruptions.ended_s"),
    # Quantiles that are lower bounds, by name.
    *(f"{table}.beyond" for table in ("one_way_delay_ms", "playout_delay_ms")),
    *(f"loop.{table}.beyond" for table in ("tick_us", "late_us")),
    *(f"limited.{limit}.share" for limit in NAMES),
}
