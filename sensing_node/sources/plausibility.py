"""Checks of a source against what a pulse can be, at its opening and while it runs.

A recording is checked whole when it is opened: what cannot be a pulse's force is refused, what is
doubtful is a warning. Samples that are only known when they come are checked as they come, counted,
and reported once. All forces in N. Pure.
"""

import logging
import math
import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sensing_node.sources.recording_file import RecordedColumn

logger = logging.getLogger(__name__)

# Twice the highest `preload` and `peak_to_peak`: no pulse presses so, at a wrist or a finger.
MOST_N = 20.0
# A pulse lower than this from peak to peak is far below what a finger feels.
LEAST_PULSE_N = 1e-3
# Below 0 N by no more than this is rounding and noise.
NEGLIGIBLE_N = 1e-3
# A share of samples below 0 N up to which a recording may be meant so: noise, a drifting base line.
MOST_BELOW = 0.1
# A pulse whose height varies is at its very highest value for less; one that was cut is not.
MOST_TOPMOST = 0.02
# What differs by less is equal, and is not stretched to anything.
SMALLEST = 1e-100
# Fewer samples may well only rise, and tell no rate.
FEW_SAMPLES = 16
RATE_TOLERANCE = 0.02
# Times further or less far apart than this are none of samples, in that unit.
SHORTEST_S, LONGEST_S = 1e-7, 1e3
# A step between two times is a gap from so many ordinary ones on.
GAP_STEPS = 5
UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_UNIT = re.compile(r"(?:^|[\s_(\[,])(s|sec|seconds|ms|us|µs|ns)[)\]]?$", re.IGNORECASE)
_TIME_NAME = re.compile(r"time|^t$|^t[_\s(\[]", re.IGNORECASE)
SETTLED_S, STILL_S = 2.0, 5.0


def refuse_constant(column: RecordedColumn) -> str | None:
    """Return that a column has one value alone; None where it has more."""
    if np.ptp(column.values) >= SMALLEST:
        return None
    return f"{_named(column)}: all values are equal, {column.values[0]:g}; it has no pulse"


def refuse_times(column: RecordedColumn) -> str | None:
    """Return that a column only rises, as times do, and what to set; None where it falls too."""
    values = column.values
    steps = np.diff(values)
    # Times that are rounded, to whole seconds say, seldom rise; so does a force that steps.
    often = np.count_nonzero(steps) >= len(steps) / 2 or _TIME_NAME.search(column.name)
    if len(values) < FEW_SAMPLES or not often or not np.all(steps >= 0):
        return None
    text = f"{_named(column)} only ever rises, as time does and no pulse"
    other = next((name for name in column.others if name and name not in column.rising), None)
    if other is not None:
        return f'{text}; set column = "{other}", or the one with the force'
    return f"{text}; set column to the one with the force" if column.others else text


def refuse_rate(column: RecordedColumn, rate_hz: float) -> str | None:
    """Return how the file's own times contradict the scene's rate; None where they do not.

    Where the times' unit is not in their name, the one is taken that comes closest to the rate.
    """
    for name, times in column.rising.items():
        step, _ = _steps(times)
        if not (_tells_time(name, times) and step > 0):
            continue
        periods_s = [step * second for second in _units_s(name)]
        rates_hz = [1 / s for s in periods_s if SHORTEST_S <= s <= LONGEST_S]
        if not rates_hz:
            continue
        own_hz = min(rates_hz, key=lambda own: abs(math.log(own / rate_hz)))
        # Times that are rounded, to whole seconds say, tell the rate no better than this.
        rounding = _ordinary(times) / (times[-1] - times[0])
        if abs(own_hz / rate_hz - 1) > RATE_TOLERANCE + rounding:
            return (
                f'column "{name}" has {own_hz:.4g} samples a second, the scene\'s rate is'
                f' {rate_hz:g} Hz; set rate = "{own_hz:.4g} Hz"'
            )
        return None
    return None


def warn_of_gaps(column: RecordedColumn) -> list[str]:
    """Return a warning of each time column whose times leave gaps."""
    warnings = []
    for name, times in column.rising.items():
        step, gaps = _steps(times)
        if step > 0 and gaps and _tells_time(name, times):
            word = "gap" if gaps == 1 else "gaps"
            warnings.append(
                f'column "{name}" has {gaps} {word}; what comes after one is played right after'
                " what was before it"
            )
    return warnings


def refuse_forces(force_n: NDArray[np.float64], unit: str, preload_n: float) -> str | None:
    """Return why forces cannot be a pulse's, and which key to set; None where they can."""
    lowest_n, highest_n = float(force_n.min()), float(force_n.max())
    largest_n = max(-lowest_n, highest_n)
    if largest_n > MOST_N:
        text = f'reaches {largest_n:.4g} N in unit "{unit}", and a pulse stays below {MOST_N:g} N'
        if unit in ("N", "V") and largest_n * 1e-3 <= MOST_N:
            return f'{text}; set unit = "m{unit}", if it is in that'
        return f'{text}; set unit, or unit = "raw" with peak_to_peak'
    share = _share_below(force_n)
    if share <= MOST_BELOW:
        return None
    text = f"is below 0 N for {100 * share:.0f} % of the samples, which no display can play"
    if highest_n <= 0:
        return f"{text}; set inverted = true, if it is positive where the pulse pulls"
    return f'{text}; set preload = "{_preload(preload_n - lowest_n):g} N" or more'


def warn_of_forces(force_n: NDArray[np.float64], unit: str, preload_n: float) -> list[str]:
    """Return warnings of forces that may be a pulse's, but hardly as it is meant."""
    warnings, span_n, share = [], float(np.ptp(force_n)), _share_below(force_n)
    topmost = float(np.count_nonzero(force_n == force_n.max())) / len(force_n)
    if topmost > MOST_TOPMOST and len(force_n) >= FEW_SAMPLES:
        warnings.append(
            f"is at its highest value for {100 * topmost:.0f} % of the samples: was it recorded"
            " beyond an ADC's range?"
        )
    if span_n < LEAST_PULSE_N:
        larger = f': is unit = "{unit.removeprefix("m")}" right?' if unit in ("mN", "mV") else ""
        warnings.append(f"is {span_n * 1e3:.3g} mN from peak to peak, which nobody feels{larger}")
    if share:
        needed_n = _preload(preload_n - float(force_n.min()))
        warnings.append(
            f"is below 0 N for {100 * share:.2g} % of the samples, which are not played;"
            f' preload = "{needed_n:g} N" prevents it'
        )
    return warnings


class SampleCheck:
    """Counter of samples that cannot be a pulse's, reported by `log` when the first one comes.

    For sources whose samples nobody knows before: live sensors above all.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_s = period_ns * 1e-9
        self._last: float | None = None
        self._reported: set[str] = set()
        self.samples = self.beyond = self.below = 0
        self._still = self._longest_still = 0

    def add(self, values: NDArray[np.float64]) -> None:
        """Check consecutive samples in N, shape (samples, channels)."""
        if not len(values):
            return
        lowest_n, highest_n = float(values.min()), float(values.max())
        self.samples += len(values)
        # Written so that NaN is beyond as well.
        if not -MOST_N <= lowest_n <= highest_n <= MOST_N:
            self.beyond += int(np.count_nonzero(~(np.abs(values) <= MOST_N).all(axis=1)))
        if not lowest_n >= -NEGLIGIBLE_N:
            self.below += int(np.count_nonzero((values < -NEGLIGIBLE_N).any(axis=1)))
        still = lowest_n == highest_n and self._last in (None, lowest_n)
        self._still = self._still + len(values) if still else 0
        self._longest_still = max(self._longest_still, self._still)
        self._last = float(values[-1, 0])
        for kind, fault in self._faults().items():
            if kind not in self._reported:
                self._reported.add(kind)
                logger.warning(fault)

    def faults(self) -> list[str]:
        """Return what was implausible so far, one line each."""
        return list(self._faults().values())

    def _faults(self) -> Mapping[str, str]:
        faults = {}
        if self.beyond:
            faults["beyond"] = (
                f"{_samples(self.beyond)} beyond {MOST_N:g} N, which no pulse reaches:"
                " check unit and scale in [sensing.source]"
            )
        share = self.below / self.samples if self.samples else 0.0
        if share > MOST_BELOW and self.samples * self._period_s >= SETTLED_S:
            faults["below"] = (
                f"{_samples(self.below)} ({100 * share:.0f} %) below 0 N, which no display can"
                " play: set a higher preload in [sensing.source], or check the sign"
            )
        still_s = self._longest_still * self._period_s
        if still_s >= STILL_S:
            faults["still"] = f"the force did not change for {still_s:.1f} s: check the sensor"
        return faults


def _samples(count: int) -> str:
    return f"{count} sample{'s' * (count != 1)}"


def _named(column: RecordedColumn) -> str:
    return f"column {column.number}" + (f' ("{column.name}")' if column.name else "")


def _share_below(force_n: NDArray[np.float64]) -> float:
    return float(np.count_nonzero(force_n < -NEGLIGIBLE_N)) / len(force_n)


def _preload(needed_n: float) -> float:
    """Return a preload that suffices, in whole steps of 50 mN."""
    return round(math.ceil(needed_n / 0.05) * 0.05, 2)


def _ordinary(times: NDArray[np.float64]) -> float:
    """Return the usual step between two times that differ; 0 where none do."""
    steps = np.diff(times)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 0.0


def _steps(times: NDArray[np.float64]) -> tuple[float, int]:
    """Return the mean step of a column of times, gaps left out, and the number of gaps."""
    steps = np.diff(times)
    in_row = steps <= GAP_STEPS * _ordinary(times)
    if not in_row.any():
        return 0.0, 0
    return float(steps[in_row].mean()), int(np.count_nonzero(~in_row))


def _tells_time(name: str, times: NDArray[np.float64]) -> bool:
    """Whether a column that never falls holds times, by its name or its even steps.

    Steps of exactly 1 may as well number the samples, and then say nothing of the rate.
    """
    if len(times) < FEW_SAMPLES:
        return False
    if _TIME_NAME.search(name):
        return True
    steps, ordinary = np.diff(times), _ordinary(times)
    low, high = np.quantile(steps, [0.1, 0.9])
    return bool(0.5 * ordinary < low <= high < 2 * ordinary and not np.all(steps == 1))


def _units_s(name: str) -> list[float]:
    """Return the units that a column of times may have, in s."""
    found = _UNIT.search(name)
    if found is None:
        return list(UNITS_S.values())
    unit = found[1].lower().replace("µ", "u")
    return [UNITS_S.get(unit, 1.0)]
