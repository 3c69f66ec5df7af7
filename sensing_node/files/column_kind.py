"""Kinds of columns: a time, a counter, a status, a monitor's number or a signal, and its pulse.

Names and content decide the kind, and the shape alone decides whether a signal has a pulse. Pure.
"""

import re
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pulse_sensors.force_scale import FORCES, VOLTAGES

TIME, COUNTER, STATUS, NUMBER, SIGNAL = "time", "counter", "status", "number", "signal"
# Units of pressure, in Pa.
PRESSURES = {"mmHg": 133.322, "cmH2O": 98.0665, "kPa": 1e3, "Pa": 1.0}
# Units of times, in s.
SECONDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "micros", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), 1e-9),
    "min": 60.0,
}
# Range of pulse rates, and rates between which each period in samples is one of them.
SLOWEST_PER_MIN, FASTEST_PER_MIN = 20.0, 300.0
ANY_HZ: Final = (10.0, 100.0, 1000.0, 10_000.0)
# Stretches in which a pulse is looked for, and the rate in Hz at which it is.
STRETCH_S, MOST_STRETCHES, SEEN_HZ = 12.0, 9, 100.0
# Least periods of a pulse in a stretch, and samples of it.
LEAST_PERIODS, FEWEST = 2, 16
# Least autocorrelation at a pulse's period, of which a stretch of n periods needs 1/n more; and its
# height above the least one before it.
LEAST_CORRELATION, LEAST_RISE = 0.35, 0.3
# Rate below which a beat has few samples, and the least correlation at one of several beats.
COARSE_HZ, LEAST_OF_PART = 20.0, 0.2
# Of several periods, the shortest that is nearly as strong.
NEARLY = 0.8
# Least changes of a value in a beat, and different values of a signal with a pulse.
LEAST_CHANGES, LEAST_LEVELS = 3, 6
# Rows from which two values are those of a status, and a value in one row of many is a number.
LEAST_ROWS, FLAG_LEVELS, ONE_ROW_IN = 100, 2, 20
# Share of the steps that are alike in a counter or a time.
MOST_STEPS = 0.9
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[^\W\d_A-Z]+")
_TIME_NAME = re.compile(r"t($|[_\s(\[])", re.IGNORECASE)
_KINDS = {
    COUNTER: r"\w*counter|\w*seq|sequence|index|idx|packets?|frames?",
    TIME: r"\w*time|time\w*|\w*zeit|zeitst\w*|\w*stamp\w*|ts|(milli|micro|nano)s(ec\w*)?"
    r"|[mun]?secs?|seconds|elapsed|dates?|datum|clock",
    STATUS: r"status|state|flags?|quality|qual|sqi|valid|errors?|markers?|events?|trig\w*"
    r"|art[ei]fact\w*|alarms?|battery|mode|conf\w*|labels?|annot\w*|leadoff|button|beats?",
    NUMBER: r"\w*rate|hr|bpm|sp|sa|mean|map|mbp|sys\w*|dia|dias\w*|sbp|dbp|nibp|nbp|avg|average"
    r"|rr|ibi|pr|temp\w*|hrv|std",
}
_ECG = r"f?ecg|ekg|ml?i{1,3}|mcl|mv|avr|avl|avf|i{1,3}|v"
_RANKS = (
    (r"force\w*|kraft\w*|load", 0),
    (r"abp|art|ubp|bp|press\w*|druck\w*|tono\w*", 1),
    (r"\w*pleth\w*|\w*ppg\w*|bvp|pulse\w*|puls|radial|ir|red|green", 2),
    (r"cvp|pap|icp|rap|lap", 3),
    (rf"{_ECG}|resp\w*|breath\w*|co|acc\w*|gyr\w*|mag\w*|eda|gsr|emg|eeg", 4),
)
PRESSURE, PPG, OTHER = 1, 2, 3


class Pulse(NamedTuple):
    """A pulse that was found, with its rate."""

    per_min: float


def words(name: str) -> list[str]:
    """Return the words of a name in small letters, and the name: "abp" and "mean" of "ABPMean"."""
    return [word.lower() for word in (name, *_WORDS.findall(name))]


def is_ecg(name: str) -> bool:
    """Return whether a name is that of an ECG or of one of its leads."""
    return any(re.fullmatch(_ECG, word) for word in words(name))


def time_unit_s(name: str) -> float | None:
    """Return the unit in s that the name of a column of times states, or None."""
    known = list(map(seconds_of, words(name)))
    return known[0] or known[-1]


def seconds_of(unit: str) -> float | None:
    """Return a unit of times in s, or None; a micro may be either of its two characters."""
    return SECONDS.get(unit.lower().replace("\u03bc", "u").replace("\u00b5", "u"))


def field(name: str) -> str:
    """Return the last part of a field's path, such as "force" of "/pulse.film.force"."""
    return name.rpartition(".")[2] if name.startswith("/") else name


def named_kind(name: str) -> str | None:
    """Return the kind that a column's name states, or None."""
    if _TIME_NAME.match(field(name)):
        return TIME
    for kind, pattern in _KINDS.items():
        if any(re.fullmatch(pattern, word) for word in words(field(name))):
            return kind
    return None


def rank(name: str, unit: str) -> float:
    """Return the rank of a signal among those with the shape of a pulse; the least is played.

    0: a force, or a pressure with its unit. 1: a pressure. 2: a PPG. 3: others. 4: other signals of
    a body. Of a message's topic, each of whose fields has it in its name, the field comes first.
    """
    if unit in FORCES:
        return 0
    for part, more in ((field(name), 0.0), (name, 0.5)):
        for pattern, place in _RANKS:
            if any(re.fullmatch(pattern, word) for word in words(part)):
                return 0 if place == PRESSURE and unit in PRESSURES else place + more
    return PRESSURE if unit in PRESSURES else OTHER


def conversion(unit: str, into: str) -> float | None:
    """Return the factor from a unit into another one, or None."""
    if unit == into:
        return 1.0
    for known in (FORCES, PRESSURES, VOLTAGES, SECONDS):
        if unit in known and into in known:
            return known[unit] / known[into]
    return None


def kind_of(name: str, unit: str, values: NDArray[Any]) -> str:
    """Return the kind of a column by its name, its unit and its values."""
    stated = named_kind(name)
    if stated is None and unit.lower() in ("bpm", "1/min", "degc", "°c"):
        stated = NUMBER
    if stated is not None or len(values) < LEAST_ROWS:
        return stated or (COUNTER if counts(values) else SIGNAL)
    known = np.asarray(values[: 1 << 16], np.float64)
    known = known[np.isfinite(known)]
    if len(known) < len(values[: 1 << 16]) / ONE_ROW_IN:
        return NUMBER
    return STATUS if len(np.unique(known)) <= FLAG_LEVELS else COUNTER if counts(known) else SIGNAL


def counts(values: NDArray[Any]) -> bool:
    """Return whether values rise evenly, as times and counters do, but for few steps back."""
    known = np.asarray(values[: 1 << 16], np.float64)
    steps = np.diff(known[np.isfinite(known)])
    rises = steps[steps > 0]
    if len(steps) < 2 or len(rises) < MOST_STEPS * np.count_nonzero(steps) or not len(rises):
        return False
    usual = float(np.median(rises))
    alike = np.count_nonzero((rises > 0.5 * usual) & (rises < 2 * usual)) >= MOST_STEPS * len(rises)
    return bool(alike or np.all(steps >= 0))


def find_pulse(values: NDArray[Any], rate_hz: float) -> Pulse | None:
    """Return the pulse of most of a record, or None.

    A pulse is periodic at 20 to 300 a minute in most stretches of 12 s, and changes several times
    a beat, which numbers that a monitor holds do not.
    """
    length = min(len(values), round(STRETCH_S * rate_hz))
    if length < max(FEWEST, LEAST_PERIODS * 60 / FASTEST_PER_MIN * rate_hz):
        return None
    count = min(MOST_STRETCHES, len(values) // length)
    begins = np.linspace(0, len(values) - length, count).astype(int)
    found = [_period_s(np.asarray(values[at : at + length], np.float64), rate_hz) for at in begins]
    periods = [period for period in found if period is not None]
    if 2 * len(periods) <= count:
        return None
    return Pulse(60 / float(np.median(periods)))


def _period_s(values: NDArray[np.float64], rate_hz: float) -> float | None:
    """Return the period of a pulse in a stretch, or None."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < FEWEST or len(set(values[known][: 1 << 12])) < LEAST_LEVELS:
        return None
    changes = int(np.count_nonzero(np.diff(values[known])))
    level, seen_hz = steady(values, rate_hz)
    for signal in (level,) if seen_hz < COARSE_HZ else (np.diff(level), level):
        period_s = _repetition_s(signal, seen_hz)
        if period_s is not None:
            beats = len(values) / rate_hz / period_s
            return period_s if changes >= LEAST_CHANGES * beats else None
    return None


def steady(values: NDArray[Any], rate_hz: float) -> tuple[NDArray[np.float64], float]:
    """Return a signal without gaps and slow changes, merged to some 100 Hz; and its rate in Hz."""
    known = np.flatnonzero(np.isfinite(values))
    values = np.interp(np.arange(len(values)), known, values[known])
    merged = max(1, int(rate_hz // SEEN_HZ))
    values = values[: len(values) // merged * merged].reshape(-1, merged).mean(axis=1)
    seen_hz = rate_hz / merged
    width = min(len(values), max(3, round(60 / SLOWEST_PER_MIN * seen_hz)))
    edged = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    sums = np.cumsum(np.insert(edged, 0, 0.0))
    return values - (sums[width:] - sums[:-width]) / width, seen_hz


def _repetition_s(values: NDArray[np.float64], rate_hz: float) -> float | None:
    """Return the time after which values repeat, within that of a pulse; or None."""
    if len(values) < FEWEST:
        return None
    values = values - values.mean()
    power = np.abs(np.fft.rfft(values, 2 * len(values))) ** 2
    most = min(round(60 / SLOWEST_PER_MIN * rate_hz) + 1, len(values) // LEAST_PERIODS)
    alike = np.fft.irfft(power)[: most + 1] / (len(values) - np.arange(most + 1))
    if not alike[0] > 0:
        return None
    alike /= alike[0]
    lowest = np.minimum.accumulate(alike)
    peaks = [
        at
        for at in range(2, most)
        if alike[at - 1] <= alike[at] >= alike[at + 1]
        and alike[at] >= LEAST_CORRELATION + at / len(values)
        and alike[at] - lowest[at] >= LEAST_RISE
    ]
    if not peaks:
        return None
    best = max(alike[at] for at in peaks)
    at = next(at for at in peaks if alike[at] >= NEARLY * best)
    if at + 1 < 60 / FASTEST_PER_MIN * rate_hz:
        return None
    before, here, after = alike[at - 1 : at + 2]
    bend = before - 2 * here + after
    period = at + (0.5 * (before - after) / bend if bend else 0.0)
    if rate_hz < COARSE_HZ:
        # Few samples repeat after several beats only; the strongest rate is that of one.
        beats = 1 + np.arange(max(1, int(FASTEST_PER_MIN / 60 * period / rate_hz)))
        parts = (period / beats).astype(int)
        part = np.maximum(alike[parts], alike[parts + 1])
        beats = beats[(beats == 1) | (part > LEAST_OF_PART) & (parts > 1)]
        period /= beats[np.argmax(power[(2 * len(values) * beats / period).astype(int)])]
    return float(period / rate_hz)
