"""A sensor that nothing presses on: its rate, its times, its noise and its zero. Pure.

Verdict of a check: ok, look (it works, but not as it should) or fail, and why.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocol.errors import BenchError

Verdict = Literal["ok", "look", "fail"]


@dataclass(frozen=True, slots=True)
class Check:
    """One line of a bench check."""

    name: str
    found: str
    verdict: Verdict = "ok"
    reason: str = ""


def with_warning(check: Check, reason: str) -> Check:
    """Return the check, at best "look" for a reason; one that is not "ok" keeps its own."""
    if not reason or check.verdict != "ok":
        return check
    return Check(check.name, check.found, "look", reason)


def grade(name: str, found: str, value: float, look: float, fail: float, reason: str) -> Check:
    """A check of a value that should be small: above `look` or `fail`, the reason is told."""
    if not value <= fail:
        return Check(name, found, "fail", reason)
    if value > look:
        return Check(name, found, "look", reason)
    return Check(name, found)


LEAST_SAMPLES = 200
MAINS_HZ = (50.0, 60.0)
HARMONICS = 3
# Displays take a stream's rate as the scene names it, and follow what a crystal is off by.
RATE_LOOK, RATE_FAIL = 0.005, 0.02
LOST_LOOK, LOST_FAIL = 0.0, 0.01
# Of a period: an even row of samples, or one that no filter can be designed for.
JITTER_LOOK, JITTER_FAIL = 0.25, 1.0
# A pulse has 0.3 N; a tenth of it is just felt (the summary's within_jnd).
NOISE_LOOK_N, NOISE_FAIL_N = 5e-3, 30e-3
ZERO_LOOK_N = 50e-3
MAINS_LOOK = 0.5


@dataclass(frozen=True, slots=True)
class SensorRecord:
    """The samples of a sensor on which nothing pressed: force in N with the time each was taken,
    the times at which batches arrived with the count of samples in each, and samples lost."""

    taken_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    arrival_ns: NDArray[np.int64]
    arrived: NDArray[np.int64]
    missing: int = 0


@dataclass(frozen=True, slots=True)
class SensorFigures:
    """The figures of such samples.

    jitter_s: RMS of what sample times are off an even row by; arrival_jitter_s: the same of when
    they could be read; age_s: how old the newest sample is when the next batch comes, at 99 % of
    all batches. mains: share of the noise's power in 50 or 60 Hz and two harmonics of it.
    """

    rate_hz: float
    jitter_s: float
    arrival_jitter_s: float
    age_s: float
    lost: float
    zero_n: float
    noise_n: float
    mains_hz: float
    mains: float


def measure(heard: SensorRecord) -> SensorFigures:
    """The figures of a record. Raises BenchError for one that is too short."""
    count = len(heard.force_n)
    if count < LEAST_SAMPLES:
        raise BenchError(f"{count} samples came; at least {LEAST_SAMPLES} are needed")
    taken_s = (heard.taken_ns - heard.taken_ns[0]) * 1e-9
    period_s, off_s = _line(np.arange(count), taken_s)
    if not period_s > 0:
        raise BenchError("the samples' times do not advance: look at the device's clock")
    last = np.cumsum(heard.arrived) - 1
    arrival_s = (heard.arrival_ns - heard.taken_ns[0]) * 1e-9
    _, arrival_off_s = _line(last, arrival_s)
    # Just before a batch comes, the newest sample is the last of the batch before it.
    ages_s = arrival_s[1:] - taken_s[last[:-1]] if len(last) > 1 else arrival_s - taken_s[last]
    _, noise_n = _line(taken_s, heard.force_n)
    mains_hz, mains = _mains(noise_n, period_s)
    return SensorFigures(
        rate_hz=1 / period_s,
        jitter_s=float(np.std(off_s)),
        arrival_jitter_s=float(np.std(arrival_off_s)),
        age_s=float(np.quantile(ages_s, 0.99)),
        lost=heard.missing / (heard.missing + count),
        zero_n=float(np.mean(heard.force_n)),
        noise_n=float(np.std(noise_n)),
        mains_hz=mains_hz,
        mains=mains,
    )


def judge_sensor(figures: SensorFigures, nominal_hz: float, live: bool = False) -> list[Check]:
    """Judge the figures; nominal_hz: the rate that the scene names; live: of a real sensor, which
    always has noise."""
    f, period_s = figures, 1 / nominal_hz
    off = abs(f.rate_hz / nominal_hz - 1)
    times = f"{f.jitter_s * 1e6:.0f} µs RMS (arrival: {f.arrival_jitter_s * 1e6:.0f} µs)"
    noise = f"{f.noise_n * 1e3:.2f} mN RMS, {f.mains * 100:.0f} % of its power at"
    checks = [
        grade(
            "rate",
            f"{f.rate_hz:.1f} Hz",
            off,
            RATE_LOOK,
            RATE_FAIL,
            f"the scene says {nominal_hz:g} Hz: correct it, or look at what the board does",
        ),
        grade(
            "jitter of sample times",
            times,
            f.jitter_s / period_s,
            JITTER_LOOK,
            JITTER_FAIL,
            "let the device send its own time with the samples",
        ),
        grade(
            "missing samples",
            f"{f.lost * 100:.2f} %",
            f.lost,
            LOST_LOOK,
            LOST_FAIL,
            "look at cable, baud rate and load",
        ),
        grade(
            "noise",
            f"{noise} {f.mains_hz:g} Hz",
            f.noise_n,
            NOISE_LOOK_N,
            NOISE_FAIL_N,
            f"a pulse has about 0.3 N, and {NOISE_FAIL_N * 1e3:.0f} mN are just felt",
        ),
        grade(
            "zero",
            f"{f.zero_n * 1e3:.1f} mN",
            abs(f.zero_n),
            ZERO_LOOK_N,
            np.inf,
            "nothing should press now; `telepulse calibrate` finds the zero",
        ),
    ]
    if not f.noise_n:
        still = next(check for check in checks if check.name == "noise")
        reason = "the reading never changes: is the sensor connected, and is its unit right?"
        checks[checks.index(still)] = with_warning(still, reason if live else "")
    if f.mains > MAINS_LOOK and f.noise_n > NOISE_LOOK_N:
        reason = "shield the film, or reject it with `mains` in [sensing.conditioning]"
        checks.append(Check("mains", f"{f.mains * 100:.0f} % of the noise", "look", reason))
    return checks


def _line(
    x: NDArray[np.float64] | NDArray[np.int64], y: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64]]:
    """Slope of the least squares line, and what is off it."""
    x = x - x.mean()
    slope = float(x @ y / (x @ x)) if len(x) > 1 else 0.0
    return slope, y - y.mean() - slope * x


def _mains(noise_n: NDArray[np.float64], period_s: float) -> tuple[float, float]:
    """The mains frequency with the larger share of the power, and that share."""
    window = np.hanning(len(noise_n))
    power = np.abs(np.fft.rfft(noise_n * window)) ** 2
    frequency_hz = np.fft.rfftfreq(len(noise_n), period_s)
    total = float(power.sum())
    # A grid wanders by some tenths of a Hz; a window's line is two bins wide to either side.
    near_hz = 0.3 + 2 * frequency_hz[1]
    shares = []
    for mains_hz in MAINS_HZ:
        lines = mains_hz * np.arange(1, HARMONICS + 1)
        near = (np.abs(frequency_hz[:, None] - lines) <= near_hz * np.arange(1, HARMONICS + 1)).any(
            1
        )
        shares.append(float(power[near].sum()) / total if total else 0.0)
    return MAINS_HZ[int(np.argmax(shares))], max(shares)
