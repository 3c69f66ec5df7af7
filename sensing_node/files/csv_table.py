"""Tables in text: columns apart by commas, semicolons, tabs or spaces; "." or "," before decimals.

A first line of words has the titles. Lines that begin with # are comments, and an empty cell is a
missing sample.
"""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from protocol.errors import SourceError
from pulse_sensors.plausibility import RecordedColumn
from sensing_node.files.columns import TIMES, in_seconds, numbers_of, titles_of
from sensing_node.files.signals import (
    ColumnKey,
    SignalFile,
    SignalInfo,
    SignalTable,
    read_text,
    split_unit,
)

if TYPE_CHECKING:
    from _csv import Reader

COMMENT = "#"
# Tried in this order; of equals, the first is taken. Decimal commas are usual beside two of them.
SEPARATORS, WITH_DECIMAL_COMMAS = ("\t", ";", ",", " "), ("\t", ";", " ")
# Lines from which separator, titles and kinds of columns are recognised.
FIRST_LINES = 20


class Layout(NamedTuple):
    """Layout of a table: its separator, and its titles, which are empty without a line of them."""

    separator: str
    titles: tuple[str, ...]
    has_titles: bool

    def number(self, text: str) -> float | None:
        """Return the number in a cell, NaN in an empty one; None for another text."""
        try:
            return float(text)
        except ValueError:
            if self.separator in WITH_DECIMAL_COMMAS and "," in text:
                return _decimal_comma(text)
            return None if text.strip() else math.nan

    def time(self, text: str) -> float | None:
        """Return the finite number in a cell, the Unix time of a date in ISO 8601, or None."""
        number = self.number(text)
        if number is not None:
            return number if math.isfinite(number) else None
        return _date(text)


def read(path: Path) -> SignalFile:
    """Open a table. Its signals are the columns whose first values are numbers or empty."""
    layout, first = _recognise(path)
    signals = [
        SignalInfo(number, *split_unit(title))
        for number, title in enumerate(layout.titles)
        if all(layout.number(row[number]) is not None for row in first if number < len(row))
    ]
    return SignalFile(path, tuple(signals), lambda keys: _load(path, keys))


def write(path: Path, table: SignalTable) -> list[str]:
    """Write a .csv file, with a column of times in s."""
    notes: list[str] = []
    grid = table.at_one_rate(notes)
    times_s = np.arange(len(grid)) / table.rate_hz
    with path.open("x", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow([TIMES, *titles_of(table)])
        rows.writerows(np.column_stack([times_s, grid]).tolist())
    return notes


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file; comments are empty lines, so that line numbers are right."""
    for line in io.StringIO(read_text(path), newline=""):
        yield "\n" if line.lstrip().startswith(COMMENT) else line


def _rows(lines: Iterator[str], separator: str) -> "Reader":
    # Of several spaces in a row, one separates.
    if separator == " ":
        lines = (line.strip() + "\n" for line in lines)
    return csv.reader(lines, delimiter=separator, skipinitialspace=separator == " ")


def _recognise(path: Path) -> tuple[Layout, list[list[str]]]:
    """Return a file's layout, and its first rows of values. Raises SourceError."""
    lines = list(islice((line for line in _lines(path) if line.strip()), FIRST_LINES + 1))
    if not lines:
        raise SourceError(f"{path}: holds no line of values")
    separator, even = ",", len(lines) // 2
    for each in SEPARATORS:
        widths = [len(row) for row in _rows(iter(lines), each)]
        count = widths.count(widths[0])
        # As many columns as in the first line, in most lines.
        if widths[0] > 1 and count > even:
            separator, even = each, count
    first, *rows = _rows(iter(lines), separator)
    plain = Layout(separator, (), False)
    has_titles = any(plain.number(cell) is None and _date(cell) is None for cell in first)
    titles = tuple(cell.strip() if has_titles else "" for cell in first)
    return Layout(separator, titles, has_titles), rows if has_titles else [first, *rows]


def _load(path: Path, keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
    layout, _ = _recognise(path)
    rows = _rows(_lines(path), layout.separator)
    first = next(row for row in rows if row)
    titles = [cell.strip() for cell in first]
    # A title that is asked for may be a number.
    has_titles = layout.has_titles or any(isinstance(key, str) for key in keys)
    numbers = numbers_of(keys, titles, path)
    # Columns whose values have not fallen yet; a pulse falls within a beat.
    rising: dict[int, list[float]] = {at: [] for at in range(len(titles)) if at not in numbers}
    dates = set[int]()
    values: list[list[float]] = [[] for _ in numbers]

    def add(row: list[str]) -> None:
        where = f"{path}: line {rows.line_num}"
        for kept, number in zip(values, numbers, strict=True):
            if number >= len(row):
                raise SourceError(f"{where}: no column {number}; it has {len(row)}")
            value = layout.number(row[number])
            if value is None:
                raise SourceError(f"{where}: {row[number][:40]!r} is not a number")
            kept.append(value)
        for place, times in list(rising.items()):
            time = layout.time(row[place]) if place < len(row) else None
            if time is None or (times and not time >= times[-1]):
                del rising[place]
            else:
                if not times and layout.number(row[place]) is None:
                    dates.add(place)
                times.append(time)

    if not has_titles:
        add(first)
    for row in rows:
        if row:
            add(row)
    names = titles if has_titles else [""] * len(titles)
    labels = [in_seconds(name) if at in dates & rising.keys() else name
              for at, name in enumerate(names)]  # fmt: skip
    others = tuple(label for at, label in enumerate(labels) if at not in numbers)
    times = {labels[at] or str(at): np.array(kept) for at, kept in rising.items()}
    return [
        RecordedColumn(
            np.array(kept, np.float64), number, split_unit(names[number])[0], others, times
        )
        for kept, number in zip(values, numbers, strict=True)
    ]


def _decimal_comma(text: str) -> float | None:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return None


def _date(text: str) -> float | None:
    """Return the Unix time of a date in ISO 8601, taken as UTC where it states no zone; or None."""
    try:
        at = datetime.fromisoformat(text.strip())
        return at.replace(tzinfo=at.tzinfo or UTC).timestamp()
    except (ValueError, OverflowError):
        return None
