"""Signals of a file, whatever its format: names, units, rates, samples, and what is missing."""

import codecs
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from protocol.errors import SourceError
from protocol.wire.description import first_repeated
from protocol.wire.marks import printable
from pulse_sensors.sample_plausibility import RATE_TOLERANCE
from pulse_sensors.text_lines import UNITS, unit_symbol
from sensing_node.files.column_kind import find_pulse, named_kind
from sensing_node.files.recording_plausibility import (
    LEAST_HZ,
    MOST_HZ,
    RecordedColumn,
    blocks,
    clock_of,
)

ColumnKey = Annotated[int, Field(ge=0)] | str
"""Number of a signal from 0, or its name."""

Floats = NDArray[np.float64]
MOST_CHARACTERS = 1000
# First bytes of a text, from which its encoding is recognised.
FIRST_BYTES = 1 << 16
_AFTER_SLASH = re.compile(r"(.*\S)\s*[/,]\s*(\S+)")
_ENDS_WITH_UNIT = re.compile(r".*_(N|mN|mmHg|kPa|mV|uV)")
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

    values: returns the samples of a signal, given by its number. notes: what was left out or is
    doubtful. left_out: reasons why signals, by name or number, are not among `signals`: "has a rate
    of 0.5 Hz". guard: makes one line of any error of a reader.

    Of a table, titles: of all columns, also of those that hold no numbers. labels: titles with the
    unit s of times. clocks: returns columns of times by number, and what was changed in them.
    """

    path: Path
    signals: tuple[SignalInfo, ...]
    values: Callable[[int], NDArray[Any]]
    notes: tuple[str, ...] = ()
    left_out: Mapping[ColumnKey, str] = field(default_factory=dict)
    guard: Callable[[], AbstractContextManager[None]] = nullcontext
    titles: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    clocks: Callable[[], tuple[dict[int, NDArray[Any]], list[str]]] = lambda: ({}, [])

    def find(self, key: ColumnKey) -> SignalInfo:
        """Return the signal of a name or number. Raises SourceError."""
        at = self._column_of(key) if self.titles else key
        for signal in self.signals:
            if at in (signal.number, signal.name):
                return signal
        for known in (key, at):
            if known in self.left_out:
                raise SourceError(f"{self.path}: signal {key!r} {self.left_out[known]}")
        if self.titles:
            title = self.titles[int(at)]
            raise SourceError(f"{self.path}: column {at}, {title!r}, holds no numbers")
        names = ", ".join(signal.name for signal in self.signals)
        raise SourceError(f"{self.path}: no signal {key!r}; it has {names[:200]}")

    def _column_of(self, key: ColumnKey) -> int:
        """Return the number of a table's column; its title may lack the unit."""
        titles, number = self.titles, key
        if isinstance(key, str):
            names = titles if key in titles else [split_unit(title)[0] for title in titles]
            number = names.index(key) if key in names else len(titles)
        if int(number) >= len(titles):
            held = ", ".join(titles)[:200] if any(titles) and isinstance(key, str) else len(titles)
            raise SourceError(f"{self.path}: no column {key!r}; it has {held}")
        return int(number)

    def load(self, keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
        """Return the samples of signals, given by names or numbers; NaN are missing.

        Raises SourceError.
        """
        found = [self.find(key) for key in keys]
        chosen = [signal.number for signal in found]
        if (twice := first_repeated(chosen)) is not None:
            raise SourceError(
                f"{self.path}: column {twice} is named twice; a column is one channel"
            )
        others = tuple(label for n, label in enumerate(self.labels) if n not in chosen)
        columns = []
        with self.guard():
            clocks, notes = self.clocks()
            for number, name, *_ in found:
                values = finite(self.values(number))
                rising = {
                    self.labels[n] or str(n): times
                    for n, times in clocks.items()
                    if n not in chosen and len(times) == len(values)
                }
                columns.append(
                    RecordedColumn(
                        values, number, name, others, rising, tuple(notes) if rising else ()
                    )
                )
        return columns

    def describe(self, column: RecordedColumn, rate_hz: float | None = None) -> SignalInfo:
        """Return what is known of a loaded column, with its rate.

        rate_hz: as an option states it; it wins. Raises SourceError without a usable rate, or where
        several are possible.
        """
        known = [signal for signal in self.signals if signal.number == column.number]
        info = known[0] if known else SignalInfo(column.number, column.name)
        rates_hz = self.rates_hz(info, column, rate_hz)
        clock = clock_of(column)
        if clock is not None and not clock.sure and rate_hz is None and info.rate_hz is None:
            rates_hz = self._with_a_pulse(column, rates_hz)
        if len(rates_hz) != 1:
            if clock is not None:
                raise SourceError(f"{self.path}: {clock.asks()}")
            raise SourceError(
                f"{self.path}: states no rate; add a column of times that never fall, or state the"
                ' rate: --rate "500 Hz" beside --source, rate = "500 Hz" in a scene, or the array'
                " rate_hz in an .npz"
            )
        if (fault := rate_fault(rates_hz[0])) is not None:
            raise SourceError(f"{self.path}: {column.title} {fault}")
        return info._replace(rate_hz=rates_hz[0])

    def rates_hz(
        self, info: SignalInfo, column: RecordedColumn, rate_hz: float | None = None
    ) -> list[float]:
        """Return the rates that a column may have; none where nothing states one.

        An option wins, then a statement in the file, then its times. Raises SourceError where times
        contradict a statement.
        """
        if rate_hz is not None:
            return [rate_hz]
        clock = clock_of(column)
        stated_hz = info.rate_hz
        if clock is None:
            return [] if stated_hz is None else [stated_hz]
        rates_hz = list(clock.rates_hz.values())
        if stated_hz is None:
            return rates_hz
        near = any(abs(r / stated_hz - 1) <= RATE_TOLERANCE + clock.rounding for r in rates_hz)
        if clock.named and not near and rates_hz:
            own = " or ".join(f"{rate:.4g} Hz" for rate in rates_hz)
            raise SourceError(
                f"{self.path}: states {stated_hz:g} Hz, and its times, column"
                f' "{clock.name}", are {own}; state the right one: --rate'
            )
        return [stated_hz]

    def _with_a_pulse(self, column: RecordedColumn, rates_hz: Sequence[float]) -> list[float]:
        """Return the rates at which a column has a pulse; if none, any other signal has."""
        found = [rate for rate in rates_hz if find_pulse(column.values, rate)]
        for signal in self.signals:
            if not found and signal.number != column.number and not named_kind(signal.name):
                values = self.values(signal.number)
                found = [rate for rate in rates_hz if find_pulse(values, rate)]
        return found


def rate_fault(rate_hz: float | None) -> str | None:
    """Return the fault of a signal's rate, or None; a file may state no rate."""
    if rate_hz is None or LEAST_HZ <= rate_hz <= MOST_HZ:
        return None
    return f"has a rate of {rate_hz:g} Hz; rates are {LEAST_HZ:g} Hz to {MOST_HZ:g} Hz"


def clean(text: str) -> str:
    """Return a text of a file in one printable line."""
    return printable(text, MOST_CHARACTERS)


def finite(values: NDArray[Any]) -> NDArray[Any]:
    """Return values with NaN, which is a missing sample, for each that is not finite."""
    if values.dtype.kind in "iu" or not any(np.isinf(block).any() for block in blocks(values)):
        return values
    return np.where(np.isfinite(values), values, np.nan)


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
    """Return name and unit of a title: "ABP [mmHg]", "Force (mN)", "Kraft / mN", "force_N".

    A number in brackets, as in "data[0]", is no unit.
    """
    if (found := _NAMED_UNIT.fullmatch(name.strip())) and not found[2].isdecimal():
        return found[1], unit_symbol(found[2])
    if (found := _ENDS_WITH_UNIT.fullmatch(name.strip())) is not None:
        return name, found[1]
    found = _AFTER_SLASH.fullmatch(name.strip())
    known = found and UNITS.fullmatch(found[2])
    return (found[1], unit_symbol(found[2])) if found and known else (name, "")


def aligned(signals: Sequence[SignalInfo], values: Sequence[Floats], rate_hz: float) -> Floats:
    """Return signals on one grid, shape (samples, signals).

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
    return grid
