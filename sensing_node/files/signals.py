"""Signals of a file, whatever its format: names, units, rates, samples, and what is missing."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from protocol.config.quantities import count_text
from protocol.errors import SourceError
from protocol.wire.stream import first_repeated
from pulse_sensors.plausibility import GAP_STEPS, RecordedColumn

ColumnKey = Annotated[int, Field(ge=0)] | str
"""Number of a signal from 0, or its name."""

Floats = NDArray[np.float64]
# Limits of a rate in Hz that a file may state.
LEAST_HZ, MOST_HZ = 1.0, 100_000.0
# Largest share of a signal that gaps may be: times beyond it are damaged.
MOST_GAPS = 20
# Samples of a gap that any signal may have.
FREE_GAP = 200_000
_NAMED_UNIT = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")


class SignalInfo(NamedTuple):
    """Properties of a signal: its number from 0, name, unit as in the file, and rate.

    rate_hz: None where the file states none. begin_s: time of the first sample after the file's
    begin.
    """

    number: int
    name: str
    unit: str = ""
    rate_hz: float | None = None
    samples: int = 0
    begin_s: float = 0.0


class FileMark(NamedTuple):
    """An annotation: seconds after the file's begin, text, and its length in s if it has one."""

    at_s: float
    text: str
    length_s: float | None = None


@dataclass(frozen=True)
class SignalFile:
    """An open file of signals.

    Attributes
    ----------
    signals : tuple of SignalInfo
        The file's signals.
    load : callable
        Return the samples of signals, given by names or numbers; NaN are missing. Raises
        SourceError.
    begin_ns : int or None
        Unix time of the begin; None where the file states none.
    notes : tuple of str
        What was left out or is doubtful.
    marks : tuple of FileMark
        Annotations in the file.
    metadata : mapping of str to str
        Further texts of the file.
    """

    path: Path
    signals: tuple[SignalInfo, ...]
    load: Callable[[Sequence[ColumnKey]], list[RecordedColumn]]
    begin_ns: int | None = None
    notes: tuple[str, ...] = ()
    marks: tuple[FileMark, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)

    def find(self, key: ColumnKey) -> SignalInfo:
        """Return the signal of a name or number. Raises SourceError."""
        for signal in self.signals:
            if key in (signal.number, signal.name):
                return signal
        names = ", ".join(signal.name for signal in self.signals)
        raise SourceError(f"{self.path}: no signal {key!r}; it has {names[:200]}")


class SignalTable(NamedTuple):
    """Signals with their samples, to be written into a file; NaN are missing."""

    signals: Sequence[SignalInfo]
    values: Sequence[Floats]
    begin_ns: int | None = None
    marks: Sequence[FileMark] = ()
    metadata: Mapping[str, str] = {}

    @property
    def rate_hz(self) -> float:
        """The highest rate."""
        return max(signal.rate_hz or 0.0 for signal in self.signals)

    def at_one_rate(self, notes: list[str], rate_hz: float | None = None) -> Floats:
        """Return all signals at the highest rate, shape (samples, signals); note a change."""
        rate_hz = rate_hz or self.rate_hz
        slower = [s.name for s in self.signals if s.rate_hz != rate_hz]
        if slower:
            notes.append(f"interpolated at {rate_hz:g} Hz: {', '.join(slower)[:200]}")
        return aligned(self.signals, self.values, rate_hz)[1]


class SignalWriter(Protocol):
    """A format's writer."""

    def __call__(self, path: Path, table: SignalTable) -> list[str]:
        """Write a new file; return what it could not hold. Raises OSError or SourceError."""


class SignalReader(Protocol):
    """A format's reader."""

    def __call__(self, path: Path) -> SignalFile:
        """Open a file. Any error of it becomes one line."""


def signal_file(
    path: Path,
    signals: Sequence[SignalInfo],
    values: Callable[[SignalInfo], Floats],
    begin_ns: int | None = None,
    notes: Sequence[str] = (),
    marks: Sequence[FileMark] = (),
    metadata: Mapping[str, str] = {},
) -> SignalFile:
    """Return a file whose signals are read one by one, by `values`. Raises SourceError."""
    if not signals:
        raise SourceError(f"{path}: holds no signal of numbers")
    for signal in signals:
        if signal.rate_hz is not None and not LEAST_HZ <= signal.rate_hz <= MOST_HZ:
            raise SourceError(
                f"{path}: signal {signal.name!r} has a rate of {signal.rate_hz:g} Hz; rates are"
                f" {LEAST_HZ:g} Hz to {MOST_HZ:g} Hz"
            )

    def load(keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
        found = [opened.find(key) for key in keys]
        twice = first_repeated(signal.number for signal in found)
        if twice is not None:
            raise SourceError(f"{path}: column {twice} is named twice; a column is one channel")
        return [RecordedColumn(values(each), each.number, each.name) for each in found]

    opened = SignalFile(
        path, tuple(signals), load, begin_ns, tuple(notes), tuple(marks), dict(metadata)
    )
    return opened


def split_unit(name: str) -> tuple[str, str]:
    """Return name and unit of a column's title such as "ABP [mmHg]"; the unit may be empty."""
    found = _NAMED_UNIT.fullmatch(name.strip())
    return (found[1], found[2]) if found else (name, "")


def on_grid(t_s: Floats, values: Floats, rate_hz: float, path: Path) -> Floats:
    """Return values at a constant rate, NaN where no time is near.

    Parameters
    ----------
    t_s : ndarray, shape (samples,)
        Ascending times in s.
    values : ndarray, shape (samples,)
        Value at each time.

    Raises
    ------
    SourceError
        If times fall, or gaps are longer than `MOST_GAPS` times the signal.
    """
    falls = np.flatnonzero(~(np.diff(t_s) >= 0))
    if len(falls) or not np.all(np.isfinite(t_s)):
        at = int(falls[0]) + 1 if len(falls) else 0
        raise SourceError(f"{path}: the times fall at sample {at}; sort or repair the file")
    places = (t_s - t_s[0]) * rate_hz if len(t_s) else t_s
    if len(t_s) and places[-1] > MOST_GAPS * len(t_s) + FREE_GAP:
        raise SourceError(
            f"{path}: {count_text(len(t_s), 'sample')} at {rate_hz:g} Hz extend over"
            f" {t_s[-1] - t_s[0]:.4g} s; its times are damaged"
        )
    numbers = np.rint(places).astype(np.int64)
    grid = np.full(int(numbers[-1]) + 1 if len(numbers) else 0, np.nan)
    grid[numbers] = values
    return grid


def evenly(
    t_s: Floats, values: Floats, path: Path, rate_hz: float | None = None
) -> tuple[float, Floats]:
    """Return the rate in Hz of time-stamped values, and the values at that rate.

    Values whose times are even within half a sample are returned as they are; others are
    interpolated linearly, with NaN in gaps longer than `GAP_STEPS` usual steps.

    Parameters
    ----------
    t_s : ndarray, shape (samples,)
        Ascending times in s.
    rate_hz : float, optional
        The rate, where it is known.

    Raises
    ------
    SourceError
        If times fall, do not differ, or extend too far.
    """
    steps = np.diff(t_s)
    rises = steps[steps > 0]
    if not len(rises):
        raise SourceError(f"{path}: its times do not rise")
    usual = float(np.median(rises))
    rate_hz = rate_hz or 1 / float(steps[steps <= GAP_STEPS * usual].mean())
    count = round(float(t_s[-1] - t_s[0]) * rate_hz) + 1 if np.all(np.isfinite(t_s)) else 0
    if count == len(t_s):
        at_s = t_s[0] + np.arange(count) / rate_hz
        if float(np.abs(t_s - at_s).max()) < 0.5 / rate_hz:
            return rate_hz, values
    # Checks the times, too.
    length = len(on_grid(t_s, values, rate_hz, path))
    at_s = t_s[0] + np.arange(length) / rate_hz
    after = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
    even: Floats = np.interp(at_s, t_s, values)
    near_s = np.minimum(np.abs(t_s[after] - at_s), np.abs(at_s - t_s[after - 1]))
    apart = (steps[after - 1] > GAP_STEPS * usual) & (near_s > 0.5 / rate_hz)
    even[apart] = np.nan
    return rate_hz, even


class Gaps(NamedTuple):
    """Missing samples of a signal: their number, that of runs of them, and the longest run."""

    samples: int
    runs: int
    longest: int

    def text(self, length: int, rate_hz: float) -> str:
        """Return the gaps of a signal of some length, for people."""
        return (
            f"{count_text(self.samples, 'sample is', 'samples are')} missing"
            f" ({100 * self.samples / length:.2g} %) in {count_text(self.runs, 'gap')}, the longest"
            f" of {self.longest / rate_hz:.3g} s"
        )


def find_gaps(values: Floats) -> Gaps:
    """Count the NaN of a signal."""
    missing = np.isnan(values)
    edges = np.flatnonzero(np.diff(missing, prepend=False, append=False))
    lengths = edges[1::2] - edges[::2]
    return Gaps(int(missing.sum()), len(lengths), int(lengths.max(initial=0)))


def fill_gaps(values: Floats) -> Floats:
    """Return a signal with straight lines through its gaps; it must have a value."""
    known = np.flatnonzero(~np.isnan(values))
    if len(known) == len(values):
        return values
    filled: Floats = np.interp(np.arange(len(values)), known, values[known])
    return filled


def aligned(
    signals: Sequence[SignalInfo], values: Sequence[Floats], rate_hz: float
) -> tuple[float, Floats]:
    """Return signals on one grid: its begin in s, and an array of shape (samples, signals).

    Signals of another rate or phase are interpolated linearly; NaN before and after a signal.
    """
    begins = [signal.begin_s for signal in signals]
    rates = [signal.rate_hz or rate_hz for signal in signals]
    ends = [
        begin + len(each) / rate for begin, each, rate in zip(begins, values, rates, strict=True)
    ]
    begin_s = min(begins)
    if len(set(begins)) == 1 and all(rate == rate_hz for rate in rates):
        length = max(map(len, values))
    else:
        length = round((max(ends) - begin_s) * rate_hz)
    grid = np.full((length, len(values)), np.nan)
    at_s = begin_s + np.arange(length) / rate_hz
    for column, (begin, each, rate) in enumerate(zip(begins, values, rates, strict=True)):
        if begin == begin_s and rate == rate_hz:
            grid[: len(each), column] = each[:length]
        else:
            times_s = begin + np.arange(len(each)) / rate
            # The last sample holds for its period.
            known = (at_s >= begin) & (at_s < begin + len(each) / rate - 1e-9)
            grid[known, column] = np.interp(at_s[known], times_s, each)
    return begin_s, grid
