"""Signals of a file, whatever its format: names, units, rates, samples, and what is missing."""

import codecs
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from protocol.errors import SourceError
from protocol.wire.stream import first_repeated
from pulse_sensors.plausibility import RecordedColumn, StatedTimes, blocks, stated_times
from sensing_node.files.bounds import read_whole

ColumnKey = Annotated[int, Field(ge=0)] | str
"""Number of a signal from 0, or its name."""

Floats = NDArray[np.float64]
# Limits of a rate in Hz that a file may state.
LEAST_HZ, MOST_HZ = 1.0, 100_000.0
# First bytes of a text, from which its encoding is recognised.
FIRST_BYTES = 1 << 16
UNITS = re.compile(
    r"[mµμu]?[NVAg]|kg|[hkm]?Pa|m?bar|mmHg|cmH2O|NU|a\.?u\.?|ad[cu]|counts?|raw|lsb|%|°?C|degC|bpm"
    r"|1/min|k?Hz|m/s[2²]|deg|dps|k?ohm|[mµμun]?s|min",
    re.IGNORECASE,
)
_AFTER_SLASH = re.compile(r"(.*\S)\s*[/,]\s*(\S+)")
_NAMED_UNIT = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")


class SignalInfo(NamedTuple):
    """Properties of a signal: its number from 0, name, unit as in the file, and rate.

    rate_hz: None where the file states none. begin_s: time of the first sample after the
    earliest one of the file.
    """

    number: int
    name: str
    unit: str = ""
    rate_hz: float | None = None
    samples: int = 0
    begin_s: float = 0.0


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
    notes : tuple of str
        What was left out or is doubtful.
    left_out : mapping of str or int to str
        Reasons why signals, by name or number, are not among `signals`: "has a rate of 0.5 Hz".
    """

    path: Path
    signals: tuple[SignalInfo, ...]
    load: Callable[[Sequence[ColumnKey]], list[RecordedColumn]]
    notes: tuple[str, ...] = ()
    left_out: Mapping[ColumnKey, str] = field(default_factory=dict)

    def find(self, key: ColumnKey) -> SignalInfo:
        """Return the signal of a name or number. Raises SourceError."""
        return find_signal(self.path, key, self.signals, self.left_out)

    def describe(
        self, column: RecordedColumn, rate_hz: float | None = None
    ) -> tuple[SignalInfo, StatedTimes | None]:
        """Return what is known of a loaded column, with its rate, and the times that state it.

        rate_hz: rate of a file that states none. Raises SourceError without a usable rate.
        """
        known = [signal for signal in self.signals if signal.number == column.number]
        info = known[0] if known else SignalInfo(column.number, column.name)
        times = stated_times(column) if info.rate_hz is None and rate_hz is None else None
        if info.rate_hz is None:
            info = info._replace(rate_hz=rate_hz if times is None else times.rate_hz)
        if info.rate_hz is None:
            raise SourceError(
                f"{self.path}: states no rate; add a column of times that never fall, or state the"
                ' rate: --rate "500 Hz" beside --source, rate = "500 Hz" in a scene, or the array'
                " rate_hz in an .npz"
            )
        if (fault := rate_fault(info.rate_hz)) is not None:
            raise SourceError(f"{self.path}: {column.title} {fault}")
        return info, times


def find_signal(
    path: Path,
    key: ColumnKey,
    signals: Sequence[SignalInfo],
    left_out: Mapping[ColumnKey, str] = {},
) -> SignalInfo:
    """Return the signal of a name or number. Raises SourceError."""
    for signal in signals:
        if key in (signal.number, signal.name):
            return signal
    if key in left_out:
        raise SourceError(f"{path}: signal {key!r} {left_out[key]}")
    names = ", ".join(signal.name for signal in signals)
    raise SourceError(f"{path}: no signal {key!r}; it has {names[:200]}")


class SignalReader(Protocol):
    """A format's reader."""

    def __call__(self, path: Path) -> SignalFile:
        """Open a file. Any error of it becomes one line."""


def signal_file(
    path: Path,
    signals: Sequence[SignalInfo],
    values: Callable[[SignalInfo], Floats],
    notes: Sequence[str] = (),
    left_out: Mapping[ColumnKey, str] = {},
) -> SignalFile:
    """Return a file whose signals are read one by one, by `values`."""

    def load(keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
        # Not of the file itself: a cycle would keep its samples after their use.
        found = [find_signal(path, key, signals, left_out) for key in keys]
        twice = first_repeated(signal.number for signal in found)
        if twice is not None:
            raise SourceError(f"{path}: column {twice} is named twice; a column is one channel")
        return [RecordedColumn(values(each), each.number, each.name) for each in found]

    return SignalFile(path, tuple(signals), load, tuple(notes), left_out)


def rate_fault(rate_hz: float | None) -> str | None:
    """Return the fault of a signal's rate, or None; a file may state no rate."""
    if rate_hz is None or LEAST_HZ <= rate_hz <= MOST_HZ:
        return None
    return f"has a rate of {rate_hz:g} Hz; rates are {LEAST_HZ:g} Hz to {MOST_HZ:g} Hz"


def finite(values: NDArray[Any]) -> NDArray[Any]:
    """Return values with NaN, which is a missing sample, for each that is not finite."""
    if values.dtype.kind in "iu" or not any(np.isinf(block).any() for block in blocks(values)):
        return values
    return np.where(np.isfinite(values), values, np.nan)


def read_text(path: Path) -> str:
    """Return the text of a file."""
    return read_whole(path).decode(text_encoding(path), "replace")


def text_encoding(path: Path) -> str:
    """Return the encoding of a text: UTF-8, UTF-16, or else Latin-1."""
    with path.open("rb") as file:
        data = file.read(FIRST_BYTES)
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    if data[:4].count(0) == 2:
        return "utf-16-le" if data[1] == 0 else "utf-16-be"
    try:
        # The last character may be cut.
        codecs.getincrementaldecoder("utf-8")().decode(data)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def split_unit(name: str) -> tuple[str, str]:
    """Return name and unit of a title: "ABP [mmHg]", "Force (mN)", "Kraft / mN"; or no unit.

    A number in brackets, as in "data[0]", is no unit.
    """
    if (found := _NAMED_UNIT.fullmatch(name.strip())) and not found[2].isdecimal():
        return found[1], found[2]
    found = _AFTER_SLASH.fullmatch(name.strip())
    return (found[1], found[2]) if found and UNITS.fullmatch(found[2]) else (name, "")


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
