"""Tables of a node's loop in a run's summary: cost and lateness of its ticks, and its deadlines."""

from dataclasses import dataclass

from protocol.figures import (
    MICROSECONDS,
    MILLISECONDS,
    SHARE,
    Surface,
    absent,
    figure,
    table,
    texts,
)
from protocol.summary_tables import AT_THE_END, NOT_RECORDED, bounds, quantile


@dataclass(frozen=True, slots=True)
class TickTime:
    """Cost of a tick."""

    p50: float | None = quantile("Cost of a tick", 0.5)
    p99: float | None = quantile("Cost of a tick", 0.99)
    beyond: list[str] = bounds()


@dataclass(frozen=True, slots=True)
class Lateness:
    """Lateness of ticks at their beginning."""

    p50: float | None = quantile("Lateness of a tick's begin", 0.5)
    p99: float | None = quantile("Lateness of a tick's begin", 0.99)
    p999: float | None = quantile("Lateness of a tick's begin", 0.999)
    max: float | None = figure(
        "Latest begin of a tick", "max {}", metric="tick_lateness_max_seconds"
    )
    beyond: list[str] = bounds()


@dataclass(frozen=True, slots=True)
class Deadlines:
    """Missed ticks and longest gap within 5 s."""

    missed: float | None = figure(
        "Share of the ticks that were missed",
        "{} of the ticks missed",
        SHARE._replace(form=".2f"),
        title="ticks missed",
        metric="deadline_missed_ratio",
    )
    gap_ms: float | None = figure(
        "Longest time between two ticks",
        "longest gap {}",
        MILLISECONDS._replace(form=".0f"),
        metric="tick_gap_seconds",
    )


@dataclass(frozen=True, slots=True)
class Loop:
    """The node's loop."""

    ticks: int | None = figure("Ticks of the loop", metric="ticks_total", noun=("tick", "ticks"))
    deadline_misses: int | None = figure(
        "Ticks that began a period late or more",
        metric="deadline_misses_total",
        noun=("deadline miss", "deadline misses"),
        prominent=True,
    )
    tick_us: TickTime = table(
        TickTime, "tick cost", MICROSECONDS, "tick_seconds", absent=AT_THE_END | NOT_RECORDED
    )
    late_us: Lateness = table(
        Lateness, "tick lateness", MICROSECONDS, "tick_lateness_seconds", absent=AT_THE_END
    )
    late: bool | None = figure(
        "The deadline alarm is on: more than 1 % of the ticks of the last 5 s were missed while a"
        " pulse was felt,"
        " or a gap was longer than the drive's watchdog"
        " (50 ms without a drive)",
        metric="deadline_alarm",
        absent=absent(
            "It is the present alarm: live views show an alert, the others the worst 5 s.",
            but=Surface.METRICS,
        ),
    )
    last_5s: Deadlines = table(
        Deadlines,
        "last 5 s",
        metric='{over="5s"}',
        absent=absent(
            "Live views show an alert for high values; an ended run shows its worst 5 s.",
            but=Surface.METRICS,
        ),
    )
    worst_5s: Deadlines = table(
        Deadlines, "worst 5 s", metric='{over="worst_5s"}', absent=AT_THE_END
    )
    realtime: list[str] = figure(
        "Real-time measures that were requested and granted",
        row="real-time measures",
        show=texts,
        absent=AT_THE_END | NOT_RECORDED | absent("It is text.", Surface.METRICS),
        factory=list,
    )
