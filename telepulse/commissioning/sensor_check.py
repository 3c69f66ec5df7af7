"""Checks of a bench, and those of a sensor that nothing presses: rate, times, noise, zero. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocol.errors import BenchError
from protocol.wire.description import Channel

Verdict = Literal["ok", "warn", "fail"]
LEAST_SAMPLES = 200
MAINS_HZ = (50.0, 60.0)
HARMONICS = 3
# A pulse has about 0.3 N; a tenth of it is the just noticeable difference (within_jnd).
NOISE_WARN_N, NOISE_FAIL_N = 5e-3, 30e-3
MAINS_WARN = 0.5


@dataclass(frozen=True, slots=True)
class Check:
    """One line of a bench check: finding, verdict, and the reason where it is not ok."""

    name: str
    text: str
    verdict: Verdict = "ok"
    reason: str = ""


def with_warning(check: Check, reason: str) -> Check:
    """Return an "ok" check as "warn" with the reason, if there is one; other checks unchanged."""
    if not reason or check.verdict != "ok":
        return check
    return replace(check, verdict="warn", reason=reason)


def grade(name: str, text: str, value: float, warn: float, fail: float, reason: str) -> Check:
    """Return the check of a value that should be small, by its bounds `warn` and `fail`."""
    if not value <= fail:
        return Check(name, text, "fail", reason)
    if value > warn:
        return Check(name, text, "warn", reason)
    return Check(name, text)


@dataclass(frozen=True, slots=True)
class SensorRecord:
    """Samples of a sensor that nothing pressed.

    taken_ns, force_n: of each sample. arrival_ns, batch_sizes: of each batch. missing: samples
    that the sensor counted and that did not arrive.
    """

    taken_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    arrival_ns: NDArray[np.int64]
    batch_sizes: NDArray[np.int64]
    missing: int = 0


def of_each_force(
    record: SensorRecord, values: NDArray[np.float64], channels: Sequence[Channel]
) -> dict[str, SensorRecord]:
    """Return the record of each channel of force by its name; values: shape (n, channels)."""
    return {
        channel.name: replace(record, force_n=values[:, n])
        for n, channel in enumerate(channels)
        if not channel.announces
    }


def judge_sensor(record: SensorRecord, nominal_hz: float, live: bool = False) -> list[Check]:
    """Judge a record against the scene's rate; live: the sensor is real, so it has noise.

    Raises BenchError for a record that is too short, or whose times do not advance.
    """
    count, nominal_s = len(record.force_n), 1 / nominal_hz
    if count < LEAST_SAMPLES:
        raise BenchError(
            f"{count} samples came from the sensor; at least {LEAST_SAMPLES} are needed"
        )
    taken_s, arrival_s, last = _times_s(record)
    period_s, off_s = _fit_line(np.arange(count), taken_s)
    if not period_s > 0:
        raise BenchError("the samples' times do not advance: check the device's clock")
    rate_hz, jitter_s = 1 / period_s, float(np.std(off_s))
    arrival_jitter_s = float(np.std(_fit_line(last, arrival_s)[1]))
    lost = record.missing / (record.missing + count)
    # A drift is no noise.
    _, off_n = _fit_line(taken_s, record.force_n)
    noise_n, zero_n = float(np.std(off_n)), float(np.mean(record.force_n))
    mains_hz, mains = _mains(off_n, period_s)
    # Name, finding, value, bounds of "warn" and "fail", and the reason.
    table = (
        # A display assumes the scene's rate, and follows the deviation of a crystal.
        ("rate", f"{rate_hz:.1f} Hz", abs(rate_hz / nominal_hz - 1), 0.005, 0.02,
         f"the scene has {nominal_hz:g} Hz: correct it, or check the board"),
        # Shares of a period. No filter can be designed for samples that are a whole period off.
        ("jitter of sample times",
         f"{jitter_s * 1e6:.0f} µs RMS (arrival: {arrival_jitter_s * 1e6:.0f} µs)",
         jitter_s / nominal_s, 0.25, 1.0,
         "let the device send its own time with the samples; where it does, check this machine's"
         " load and the adapter's latency timer"),
        ("missing samples", f"{lost * 100:.2f} %", lost, 0.0, 0.01,
         "check cable, baud rate and load"),
        ("noise",
         f"{noise_n * 1e3:.2f} mN RMS, {mains * 100:.0f} % of its power at {mains_hz:g} Hz",
         noise_n, NOISE_WARN_N, NOISE_FAIL_N,
         "nothing may press the sensor during this check: a pulse has about 0.3 N, and"
         f" {NOISE_FAIL_N * 1e3:.0f} mN are just felt"),
        ("zero", f"{zero_n * 1e3:z.1f} mN", abs(zero_n), 50e-3, np.inf,
         "nothing should press now; `telepulse calibrate` finds the zero"),
    )  # fmt: skip
    checks = {row[0]: grade(*row) for row in table}
    if live and not noise_n:
        reason = "the reading never changes: is the sensor connected, and is its unit right?"
        checks["noise"] = with_warning(checks["noise"], reason)
    if mains > MAINS_WARN and noise_n > NOISE_WARN_N:
        reason = "shield the film, or reject it with `mains` in [sensing.conditioning]"
        checks["mains"] = Check("mains", f"{mains * 100:.0f} % of the noise", "warn", reason)
    return list(checks.values())


def reading_age_s(record: SensorRecord) -> float:
    """Return the age of the newest sample just before the next batch, 99th percentile, in s."""
    taken_s, arrival_s, last = _times_s(record)
    # Just before a batch arrives, the newest sample is the last one of the previous batch.
    ages_s = arrival_s[1:] - taken_s[last[:-1]] if len(last) > 1 else arrival_s - taken_s[last]
    return float(np.quantile(ages_s, 0.99))


def _times_s(
    record: SensorRecord,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return times of the samples and of the batches' arrival, and each batch's last sample."""
    begin_ns, last = record.taken_ns[0], np.cumsum(record.batch_sizes) - 1
    return (record.taken_ns - begin_ns) * 1e-9, (record.arrival_ns - begin_ns) * 1e-9, last


def _fit_line(
    x: NDArray[np.float64] | NDArray[np.int64], y: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64]]:
    """Return slope and residuals of the least squares line."""
    x = x - x.mean()
    slope = float(x @ y / (x @ x)) if len(x) > 1 else 0.0
    return slope, y - y.mean() - slope * x


def _mains(noise_n: NDArray[np.float64], period_s: float) -> tuple[float, float]:
    """Return the mains frequency with the larger share of the power, and that share."""
    power = np.abs(np.fft.rfft(noise_n * np.hanning(len(noise_n)))) ** 2
    frequency_hz = np.fft.rfftfreq(len(noise_n), period_s)
    total = float(power.sum())
    # A grid's frequency varies by some 0.1 Hz; a windowed line is two bins wide on either side.
    near_hz = 0.3 + 2 * frequency_hz[1]
    orders = np.arange(1, HARMONICS + 1)
    shares = []
    for mains_hz in MAINS_HZ:
        off_hz = np.abs(frequency_hz[:, None] - mains_hz * orders)
        near = (off_hz <= near_hz * orders).any(axis=1)
        shares.append(float(power[near].sum()) / total if total else 0.0)
    return MAINS_HZ[int(np.argmax(shares))], max(shares)
