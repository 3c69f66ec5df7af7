"""Figures of the pulse's beats, for the summary (`protocol.figures`)."""

from dataclasses import dataclass

from protocol.figures import MILLISECONDS, NEWTONS, RATIO, SHARE, Surface, Unit, absent, figure

PER_MINUTE = Unit("1/min", "/min", ".0f", base=1 / 60)
WHOLE_MILLISECONDS = MILLISECONDS._replace(form=".0f")


@dataclass(frozen=True, slots=True)
class AnnounceFigures:
    """Figures of an ECG that announces the beats; of a stream without one, all are null."""

    r_waves: int | None = figure(
        "R waves found in the channel that announces the beats",
        metric="r_waves_total",
        noun=("R wave", "R waves"),
    )
    used: float | None = figure(
        "Share of the R waves that came while the predictor used them",
        "{} used",
        SHARE,
        metric="r_waves_used_ratio",
    )
    unused: str | None = figure(
        "Why R waves are not used at present; null where they are",
        "now unused: {}",
        absent=absent("A metric is a number: `used` is one.", Surface.METRICS),
    )
    transit_ms: float | None = figure(
        "Time from an R wave to the steepest rise of its pulse: median of the last 9",
        "transit time {}",
        WHOLE_MILLISECONDS,
        metric="transit_time_seconds",
    )
    deviation_ms: float | None = figure(
        "Robust standard deviation of that time",
        "varying by {}",
        WHOLE_MILLISECONDS._replace(form=".1f"),
        metric="transit_time_deviation_seconds",
    )


@dataclass(frozen=True, slots=True)
class BeatFigures:
    """Figures of the received pulse; medians are over the last minute of good beats."""

    count: int | None = figure(
        "Beats of the received pulse",
        metric="beats_total",
        noun=("beat", "beats"),
    )
    rate_per_min: float | None = figure(
        "Heart rate: 60 s over the median interval from onset to onset",
        unit=PER_MINUTE,
        title="heart rate",
        metric="beat_rate_hertz",
    )
    variability_ms: float | None = figure(
        "Standard deviation of the intervals",
        "varying by {}",
        WHOLE_MILLISECONDS,
        title="deviation of the intervals",
        metric="beat_interval_deviation_seconds",
    )
    height_n: float | None = figure(
        "Force at the wrist from the foot to the systolic peak, median",
        "height {}",
        NEWTONS._replace(form=".1f"),
        metric="beat_height_newtons",
    )
    upstroke_ms: float | None = figure(
        "Time from the onset to the systolic peak, median",
        "upstroke {}",
        WHOLE_MILLISECONDS,
        metric="beat_upstroke_seconds",
    )
    notch_ms: float | None = figure(
        "Time from the onset to the dicrotic notch, median; null where most beats have none",
        "notch after {}",
        WHOLE_MILLISECONDS,
        metric="beat_notch_seconds",
    )
    quality: float | None = figure(
        "Quality of the newest beat, 0 to 1: how similar it is to the good beats before; 0 after"
        " 5 s without a beat",
        "quality {}",
        RATIO,
        metric="beat_quality_ratio",
        prominent=True,
    )
    doubtful: float | None = figure(
        "Share of the beats with a quality below 0.5",
        "{} doubtful",
        SHARE,
        metric="doubtful_beats_ratio",
        show_zero=False,
    )
    alarm: bool | None = figure(
        "The pulse alarm is on: two of the last three beats were doubtful, or there was none for"
        " 5 s",
        metric="pulse_alarm",
        absent=absent("Live views show it as an alert.", but=Surface.METRICS),
    )
