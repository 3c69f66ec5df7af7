"""Tables of a run's summary: each field describes one figure (`protocol.figures`)."""

from dataclasses import dataclass
from typing import Any

from protocol.figures import (
    MILLISECONDS,
    NEWTONS,
    PPM,
    RATIO,
    SHARE,
    Surface,
    absent,
    figure,
    texts,
)

# Reasons why surfaces omit figures.
AT_THE_END = absent("It belongs to the account at the end, not to the live page.", Surface.PAGE)
IN_ALERTS = absent("The page shows it as an alert.", Surface.PAGE)
BY_THE_PAGE = absent("The page computes it over the window that it shows.", Surface.PAGE)
NOT_RECORDED = absent("It describes the process, not the recorded pulse.", Surface.REPORT)


def bounds() -> Any:
    """Return the field of the quantiles of a table that are lower bounds."""
    return figure(
        "Quantiles that are lower bounds, because they are beyond the counted range",
        factory=list,
        absent=absent('It is shown as "> " before the quantile.'),
    )


def quantile(of: str, share: float) -> Any:
    """Return the field of a quantile, of a share from 0 to 1; of: what it is the quantile of."""
    name = f"p{100 * share:g}"
    return figure(f"{of}, {name}", f"{name} {{}}", metric=f'{{quantile="{share}"}}')


@dataclass(frozen=True, slots=True)
class SampleCounts:
    """sent = played + predicted + late + lost.

    A lost sample that comes after all counts as predicted or late.
    """

    sent: int | None = figure(
        "Samples sent; at a display since it joined: sent = played + predicted + late + lost",
        "{} sent",
        metric="samples_sent_total",
    )
    played: int | None = figure(
        "Samples in the buffer when their instant was played",
        "{} in time",
        metric='samples_total{outcome="played"}',
        separator=" = ",
        prominent=True,
        help="Samples that have arrived.",
    )
    predicted: int | None = figure(
        "Samples that arrived after their instant, which was felt from a trusted prediction",
        "{} felt ahead",
        metric='samples_total{outcome="predicted"}',
        separator=" + ",
    )
    late: int | None = figure(
        "Samples that arrived after their instant, without a trusted prediction of it",
        "{} late",
        metric='samples_total{outcome="late"}',
        separator=" + ",
    )
    # A gauge, because it falls when a missing sample arrives. So is the next figure, which a frame
    # out of order may change.
    lost: int | None = figure(
        "Samples that have not arrived", "{} lost", metric="samples_lost", separator=" + "
    )
    before_joining: int | None = figure(
        "Samples sent before the display joined",
        "after {}",
        metric="samples_before_joining",
        row="joined",
        noun=("sample", "samples"),
        absent=AT_THE_END | absent("A recording may begin later.", Surface.REPORT),
    )


@dataclass(frozen=True, slots=True)
class OneWayDelay:
    """Time on the network of a frame's last sample."""

    p50: float | None = quantile("Time on the network of a frame's last sample", 0.5)
    p99: float | None = quantile("Time on the network of a frame's last sample", 0.99)
    max: float | None = figure(
        "Longest one-way delay", "max {}", metric="one_way_delay_max_seconds"
    )
    beyond: list[str] = bounds()


@dataclass(frozen=True, slots=True)
class PlayoutDelay:
    """Perceived delay E from the wrist's instant to its playing."""

    mean: float | None = figure(
        "Perceived delay E, from the wrist's instant to its playing, mean",
        "mean {}",
        metric="playout_delay_mean_seconds",
    )
    p99: float | None = quantile("Perceived delay E, from the wrist's instant to its playing", 0.99)
    beyond: list[str] = bounds()


@dataclass(frozen=True, slots=True)
class Compensation:
    """Use and quality of the prediction; shares are of the time played (`Availability.played`)."""

    predicted: float | None = figure(
        "Share of the time played in which the played instant was later than the newest sample"
        " that had arrived",
        metric="predicted_ratio",
        row="felt ahead",
        unit=SHARE,
        share_of="played",
    )
    horizon_ms: float | None = figure(
        "Mean time from the newest sample that had arrived to the played instant, where that was"
        " later",
        "on average {} ahead",
        MILLISECONDS._replace(form=".1f"),
        title="mean time ahead",
        metric="prediction_horizon_mean_seconds",
        row="felt ahead",
    )
    trusted: float | None = figure(
        "Share of the time played in which trusted prediction replaced a part of the link's delay;"
        " null where trust is not used (a fixed E, `hold`, `linear`)",
        metric="trusted_ratio",
        row="prediction trusted",
        unit=SHARE,
        share_of="played",
        absent=absent("Each recorded tick has it.", Surface.REPORT),
    )
    error_n: float | None = figure(
        "RMS difference of the predicted force that was felt from the sample that came later",
        "off by {} RMS",
        NEWTONS,
        title="RMS error",
        metric="prediction_error_newtons",
        row="prediction",
    )
    error_share: float | None = figure(
        "The same over the pulse's height from foot to peak",
        "{} of the pulse's height",
        SHARE,
        title="RMS error over the pulse's height",
        metric="prediction_error_ratio",
        row="prediction",
    )
    corrections: int | None = figure(
        "How often a new sample corrected the force felt at full strength by more than 10 % of the"
        " pulse's height, which a finger notices",
        metric="felt_corrections_total",
        row="prediction",
        noun=("correction felt", "corrections felt"),
    )
    corrections_per_min: float | None = figure(
        "The same per minute of the time played",
        "{} per minute",
        RATIO._replace(form=".1f"),
        title="corrections felt per minute",
        metric="felt_corrections_per_minute",
        row="prediction",
        show_zero=False,
        absent=absent("Follows from the counter.", Surface.METRICS),
    )
    noticed_5s: float | None = figure(
        "Share of the last 5 s in which the predicted force that was felt was off by more than"
        " 10 % of the pulse's height",
        unit=SHARE,
        metric="prediction_noticed_ratio",
        absent=absent("Live views show an alert for high values.", but=Surface.METRICS),
    )
    alarm: bool | None = figure(
        "The prediction alarm is on: `noticed_5s` was above 5 %, and is not below 2.5 % yet",
        metric="prediction_alarm",
        absent=absent("The page shows it as an alert.", but=Surface.METRICS),
    )


def _offset_text(offset_ms: float) -> str:
    """Return an offset in ms; in s for clocks of two hosts, which may be days apart."""
    return f"{offset_ms:z.3f} ms" if abs(offset_ms) < 1e4 else f"{offset_ms * 1e-3:z.3f} s"


@dataclass(frozen=True, slots=True)
class Clock:
    """The sensing clock against the display's."""

    offset_ms: float | None = figure(
        "Sensing clock minus display clock",
        "offset {}",
        MILLISECONDS,
        metric="clock_offset_seconds",
        show=_offset_text,
    )
    skew_ppm: float | None = figure(
        "How much faster the sensing clock runs", "skew {}", PPM, metric="clock_skew_ratio"
    )
    uncertainty_ms: float | None = figure(
        "Bound of the offset's error with a probability of about 95 %, if the delays of the two"
        " directions differ only randomly",
        "uncertainty {}",
        MILLISECONDS._replace(form=".3f"),
        metric="clock_uncertainty_seconds",
    )
    asymmetry_ms: float | None = figure(
        "Half the shortest round trip: bound of the offset's further error if"
        " one direction always takes longer",
        "asymmetry at most {}",
        MILLISECONDS,
        metric="clock_asymmetry_seconds",
        absent=absent("It is a bound for analysis, not measured.", Surface.SUMMARY, Surface.PAGE),
    )
    steps: int | None = figure(
        "How often a clock has jumped",
        metric="clock_steps_total",
        noun=("step", "steps"),
        show_zero=False,
    )


@dataclass(frozen=True, slots=True)
class AlignedErrors:
    """RMSE of the felt force against the pulse."""

    aligned: float | None = figure(
        "RMSE of the felt force against the pulse one playout delay earlier",
        "aligned {}",
        metric='{against="aligned"}',
        help="RMSE of the felt force against the pulse.",
    )
    in_phase: float | None = figure(
        "RMSE of the felt force against the pulse at the same instant",
        "in phase {}",
        metric='{against="in_phase"}',
    )


@dataclass(frozen=True, slots=True)
class Roughness:
    """The part above 25 Hz, where touch is most sensitive."""

    felt_n: float | None = figure(
        "RMS above 25 Hz of the force felt",
        "felt {}",
        NEWTONS,
        metric='roughness_newtons{force="felt"}',
        help="RMS of force above 25 Hz.",
    )
    sensed_n: float | None = figure(
        "RMS above 25 Hz of the force sensed at the same instants",
        "sensed {}",
        NEWTONS,
        metric='roughness_newtons{force="sensed"}',
    )
    energy_ratio: float | None = figure(
        "Energy above 25 Hz of the force felt over that of the force sensed",
        "energy ratio {}",
        RATIO,
        metric="roughness_energy_ratio",
    )


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Frames of the stream as they arrived."""

    received: int | None = figure("Frames accepted", "{} received", metric="frames_total")
    reordered: int | None = figure(
        "Frames that came after a newer one", "{} out of order", metric="frames_reordered_total"
    )
    copies: int | None = figure(
        "Copies of frames over further paths",
        "{} copies over further paths",
        metric="frame_copies_total",
        show_zero=False,
    )
    first: dict[str, int] = figure(
        "With several addresses: number of frames whose first copy came over each of them",
        metric="frames_first_total",
        show=lambda first: texts((f"{count} first over {name}" for name, count in first.items())),
        label="path",
        factory=dict,
    )


@dataclass(frozen=True, slots=True)
class DataConnections:
    """Parallel connections for frames."""

    open: int | None = figure(
        "Parallel connections for frames", "{} open", metric="data_connections"
    )


@dataclass(frozen=True, slots=True)
class Reconnections:
    """Connections made while one was silent."""

    opened: int | None = figure(
        "Connections for frames opened beside a silent one",
        "{} opened beside a silent connection",
        metric='reconnections_total{kind="second"}',
        show_zero=False,
        help="Connections made while one was silent.",
    )
    kept: int | None = figure(
        "Second connections that delivered first and replaced the silent one",
        "{} of them kept",
        metric='reconnections_total{kind="kept"}',
        show_zero=False,
    )
    control: int | None = figure(
        "Connections for control messages made anew",
        "{} for control",
        metric='reconnections_total{kind="control"}',
        show_zero=False,
    )
