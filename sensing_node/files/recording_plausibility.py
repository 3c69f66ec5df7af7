"""Plausibility of a recording's column: whether it can be a pulse with the scene's keys.

A recording is completely known when it is opened. The samples of a running source are checked by
`pulse_sensors/sample_plausibility.py`. All forces are in N. Pure.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from pulse_sensors.sample_plausibility import (
    LARGEST,
    MOST_BELOW,
    MOST_N,
    NEGLIGIBLE_N,
)
from sensing_node.files.column_kind import TIME, named_kind, time_unit_s

# Smallest peak-to-peak force of a pulse, far below what a finger feels.
LEAST_PULSE_N: Final = 1e-3
# Greatest share of samples at the very highest value, unless the pulse was clipped.
MOST_TOPMOST: Final = 0.02
# Values that differ by less are equal, and cannot be scaled.
SMALLEST: Final = 1e-100
# Least number of samples for a check: fewer may rise by chance, and are too few for a rate.
FEW_SAMPLES: Final = 16
# Limits of a rate in Hz that a file may state.
LEAST_HZ, MOST_HZ = 1.0, 100_000.0
# A longer step between two times than this multiple of the usual one is a gap.
GAP_STEPS: Final = 5
# Greatest first value of times in s since 1970, and least one of the year 2001.
UNIX_S = (1e9, 4e9)
# Units of times that state none.
UNITS_S = (1.0, 1e-3, 1e-6, 1e-9)
# Values that are examined at once.
BLOCK: Final = 1 << 16


def blocks(values: NDArray[Any], length: int = BLOCK) -> Iterator[NDArray[np.float64]]:
    """Yield values in 64 bits, block by block, so that a long file needs no copy in memory."""
    with np.errstate(invalid="ignore"):
        for first in range(0, len(values), length):
            yield np.asarray(values[first : first + length], dtype=np.float64)


def extremes(values: NDArray[Any]) -> tuple[float, float]:
    """Return the least and the greatest value, NaN left out; infinities of none."""
    low, high = math.inf, -math.inf
    for block in blocks(values):
        least, most = float(block.min()), float(block.max())
        if math.isnan(least):
            least = float(np.fmin.reduce(block, initial=math.inf))
            most = float(np.fmax.reduce(block, initial=-math.inf))
        low, high = min(low, least), max(high, most)
    return low, high


def never_falls(values: NDArray[Any]) -> bool:
    """Return whether values are finite and each is at least the one before it."""
    last = -math.inf
    for block in blocks(values):
        if not (np.isfinite(block).all() and block[0] >= last and np.all(block[1:] >= block[:-1])):
            return False
        last = float(block[-1])
    return True


@dataclass(frozen=True, slots=True)
class RecordedColumn:
    """One column of a recording's file.

    values: samples in the file's unit, shape (samples,), of any kind of real number. number: its
    index from 0. name: empty if the file has no names. others: names of the other columns. rising:
    other columns whose values never fall, like times, by name or number. notes: what was changed in
    them.
    """

    values: NDArray[Any]
    number: int = 0
    name: str = ""
    others: tuple[str, ...] = ()
    rising: dict[str, NDArray[Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Number and name for people."""
        return f"column {self.number}" + (f' ("{self.name}")' if self.name else "")


def unusable_values(values: NDArray[Any]) -> str | None:
    """Return the reason why a file's values are not samples of a signal, or None.

    NaN are missing samples.
    """
    if len(values) < 2:
        return f"number of samples is {len(values)}; it must be 2 or more"
    low, high = extremes(values)
    if low > high:
        return "all values are NaN"
    if max(-low, high) <= LARGEST:
        return None
    bad = np.flatnonzero(np.abs(values) > LARGEST)
    count = count_text(len(bad), "value is", "values are")
    return f"{count} beyond {LARGEST:g}, the first is sample {bad[0]}; cut or fill them"


class FileTimes(NamedTuple):
    """The times of a file: name, gaps, and the rate in Hz by each unit in s that they may have.

    named: it has the name or the unit of times. sure: its unit is stated, or is that of times since
    1970. rounding: the usual step as a share of all.
    """

    name: str
    gaps: int
    rounding: float
    rates_hz: dict[float, float]
    named: bool
    sure: bool

    def asks(self) -> str:
        """Return the units that are left, for people, and what decides."""
        units = [(rate, unit) for unit, rate in self.rates_hz.items()]
        text = " or ".join(f"{rate:.4g} Hz if in {_UNIT_NAMES[unit]}" for rate, unit in units)
        return (
            f'its times, column "{self.name}", state no unit: {text or "none is usual"};'
            f" {_setting('rate', f'{units[0][0]:.4g} Hz' if units else '100 Hz')} decides"
        )


_UNIT_NAMES = {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns", 60.0: "min"}


def clock_of(column: RecordedColumn) -> FileTimes | None:
    """Return the times of a column's file; None without any.

    Whole numbers with even steps that have no name of times are a counter. Of several times, those
    with the finest steps are taken.
    """
    clocks = list(_clocks(column))
    return min(clocks, key=lambda each: (not each.named, each.rounding), default=None)


def _clocks(column: RecordedColumn) -> Iterator[FileTimes]:
    for name, times in column.rising.items():
        steps = np.diff(times).astype(np.float64)
        rises = steps[steps > 0]
        if len(times) < FEW_SAMPLES or not len(rises):
            continue
        usual = float(np.median(rises))
        unit_s = time_unit_s(name)
        named = unit_s is not None or named_kind(name) == TIME
        if not named:
            low, high = np.quantile(steps, [0.1, 0.9])
            even = np.ptp(rises) == 0 and float(usual).is_integer()
            if not 0.5 * usual < low <= high < 2 * usual or even:
                continue
        in_row = steps <= GAP_STEPS * usual
        # Further digits are rounding, and a signal of 250.00000000000003 Hz would be interpolated.
        step = float(f"{steps[in_row].mean():.12g}")
        rates_hz, sure = {u: 1 / (step * u) for u in ([unit_s] if unit_s else UNITS_S)}, True
        if unit_s is None:
            usable = {u: hz for u, hz in rates_hz.items() if LEAST_HZ <= hz <= MOST_HZ}
            since = {u: hz for u, hz in usable.items() if UNIX_S[0] < times[0] * u < UNIX_S[1]}
            rates_hz, sure = (since, True) if len(since) == 1 else (usable, False)
        gaps = int(np.count_nonzero(~in_row))
        rounding = usual / float(times[-1] - times[0])
        yield FileTimes(name, gaps, rounding, rates_hz, named, sure)


def constant_column(column: RecordedColumn) -> str | None:
    """Return the fault of a column whose values are all equal, or None."""
    low, high = extremes(column.values)
    if high - low >= SMALLEST:
        return None
    return f"{column.title}: all values are equal, {column.values[0]:g}; it has no pulse"


class ForceRange(NamedTuple):
    """Range of a recording's forces in N, and shares of samples at its top and below 0 N."""

    lowest_n: float
    highest_n: float
    topmost: float
    below: float

    @classmethod
    def of(cls, parts: Iterable[NDArray[np.float64]]) -> Self:
        """Return the range of forces that come in parts."""
        lowest_n, highest_n, topmost, below, count = math.inf, -math.inf, 0, 0, 0
        for force_n in parts:
            top_n = float(force_n.max())
            topmost = (topmost if top_n <= highest_n else 0) + (
                int(np.count_nonzero(force_n == top_n)) if top_n >= highest_n else 0
            )
            lowest_n, highest_n = min(lowest_n, float(force_n.min())), max(highest_n, top_n)
            below += int(np.count_nonzero(force_n < -NEGLIGIBLE_N))
            count += len(force_n)
        return cls(lowest_n, highest_n, topmost / count, below / count)


def examine(
    column: RecordedColumn,
    forces: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    unit: str,
    rest_n: float,
) -> tuple[str | None, list[str]]:
    """Examine a recording's forces, not all equal, with its file and its scene's keys.

    forces: returns the forces in N of some of the column's values. Returns the reason why they
    cannot be a pulse, with advice; and what is doubtful in forces that are not refused.
    """
    refusal = _refuse_times(column)
    if refusal is None:
        found = ForceRange.of(map(forces, blocks(column.values)))
        refusal = _refuse_forces(found, unit, rest_n)
    if refusal is not None:
        return refusal, []
    few = len(column.values) < FEW_SAMPLES
    return None, [*_warn_of_gaps(column), *_warn_of_forces(found, few, unit, rest_n)]


def _refuse_times(column: RecordedColumn) -> str | None:
    """Return the fault of a column that only rises, as times do, and advice; or None."""
    values = column.values
    if len(values) < FEW_SAMPLES or not never_falls(values):
        return None
    # Where fewer than half of the steps rise, the column has rounded times or a stepped force: then
    # its name decides.
    steps = np.diff(values)
    if np.count_nonzero(steps) < len(steps) / 2 and named_kind(column.name) != TIME:
        return None
    text = f"{column.title} never falls, so it is a time and not a pulse"
    for other in column.others:
        if other and other not in column.rising:
            return f'{text}; set column = "{other}", or the one with the force'
    return f"{text}; set column to the one with the force" if column.others else text


def _warn_of_gaps(column: RecordedColumn) -> Iterator[str]:
    yield from column.notes
    clock = clock_of(column)
    if clock is not None and clock.gaps:
        yield (
            f'column "{clock.name}" has {count_text(clock.gaps, "gap")}; samples after a gap are'
            " played right after those before it"
        )
    for other in column.others:
        if named_kind(other) == TIME and other not in column.rising:
            yield f'column "{other}" has the name of times, and falls or is no number: not used'


def _refuse_forces(found: ForceRange, unit: str, rest_n: float) -> str | None:
    """Return the reason why forces cannot be a pulse, and the key to set; or None."""
    largest_n = max(-found.lowest_n, found.highest_n)
    if largest_n > MOST_N:
        text = f'reaches {largest_n:.4g} N in unit "{unit}", and a pulse stays below {MOST_N:g} N'
        if unit in ("N", "V") and largest_n * 1e-3 <= MOST_N:
            return f'{text}; set unit = "m{unit}" if the values are in m{unit}'
        return f'{text}; set unit, or unit = "raw" with peak_to_peak'
    if found.below <= MOST_BELOW:
        return None
    text = f"is below 0 N for {100 * found.below:.0f} % of the samples, which no display can play"
    if found.highest_n <= 0:
        return f"{text}; set inverted = true if the pulse presses where the values fall"
    return (
        f"{text}; set {_setting('preload', f'{_preload(rest_n - found.lowest_n):g} N', ' or more')}"
    )


def _warn_of_forces(found: ForceRange, few: bool, unit: str, rest_n: float) -> Iterator[str]:
    if found.topmost > MOST_TOPMOST and not few:
        yield (
            f"is at its highest value for {100 * found.topmost:.0f} % of the samples: was it"
            " recorded beyond an ADC's range?"
        )
    span_n = found.highest_n - found.lowest_n
    if span_n < LEAST_PULSE_N:
        larger = f': is unit = "{unit.removeprefix("m")}" right?' if unit in ("mN", "mV") else ""
        yield f"is {span_n * 1e3:.3g} mN from peak to peak, too small to feel{larger}"
    if found.below:
        preload_n = _preload(rest_n - found.lowest_n)
        yield (
            f"is below 0 N for {100 * found.below:.2g} % of the samples, which are not played;"
            f" {_setting('preload', f'{preload_n:g} N')} prevents it"
        )


def _setting(key: str, value: str, more: str = "") -> str:
    """Return a key with its value as a scene has it, and the option of a record for it."""
    return f'{key} = "{value}"{more} (beside --source: --{key})'


def _preload(needed_n: float) -> float:
    """Return a sufficient preload, in whole steps of 50 mN."""
    return round(math.ceil(needed_n / 0.05) * 0.05, 2)
