"""Tables in text, as recorders, spreadsheets and sketches write them.

Lines above the table may state titles, units and rate (`text_head.py`). Columns are apart by
commas, semicolons, tabs, bars or spaces, with "." or "," before decimals, or each number has its
label: "IR=100004 RED=79995" (`text_layout.py`). Lines that begin with #, % or // are comments; an
empty cell is a missing sample.
"""

import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, islice, zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np

from protocol.errors import SourceError
from sensing_node.files.bounds import check_regular, check_samples
from sensing_node.files.clock import time_of
from sensing_node.files.columns import column_file
from sensing_node.files.recording_plausibility import UNIX_S
from sensing_node.files.signals import Floats, SignalFile, rate_fault, text_encoding
from sensing_node.files.text_head import read_titles, stated_rate
from sensing_node.files.text_layout import (
    NUMBER,
    QUOTED,
    TEXT,
    TIME,
    Form,
    is_comment,
    labelled_numbers,
    recognise,
)

# Lines among which a table begins.
FIRST_LINES = 500
MOST_CHARACTERS = 1 << 17
ROWS_AT_ONCE = 10_000
# In place of a cell that a row lacks.
NO_CELL = "\0"
# A row, and the number of its line.
_Row = tuple[int, list[str]]


class Wrong(NamedTuple):
    """A cell that is no value: its row from 0, its text, and its fault for people."""

    row: int
    text: str
    fault: str


class TextTable:
    """Values of a table by column, NaN where missing, and the first cell of each that is none."""

    def __init__(self, form: Form, path: Path) -> None:
        self._form, self._path = form, path
        self._values = [array("d") for _ in form.kinds]
        self._lines = array("q")
        self._wrong: dict[int, Wrong] = {}

    def __len__(self) -> int:
        return len(self._lines)

    def add(self, rows: Sequence[_Row]) -> None:
        """Add rows. Raises SourceError for more of them than are read."""
        kinds, first = self._form.kinds, len(self)
        self._lines.extend(number for number, _ in rows)
        check_samples(self._path, len(self) * len(kinds))
        columns = list(zip_longest(*(cells for _, cells in rows), fillvalue=NO_CELL))
        columns += [(NO_CELL,) * len(rows)] * (len(kinds) - len(columns))
        for at, (kind, cells) in enumerate(zip(kinds, columns, strict=False)):
            if kind == TEXT:
                continue
            numbers = self._form.layout.numbers
            values = numbers(cells) if kind == NUMBER else list(map(time_of, cells))
            if None in values and at not in self._wrong:
                n = values.index(None)
                self._wrong[at] = Wrong(first + n, cells[n], self._fault(at, cells[n], rows[n]))
            self._values[at].extend(math.nan if value is None else value for value in values)

    def _fault(self, at: int, cell: str, row: _Row) -> str:
        """Return what is wrong with a cell of a column, with its line."""
        number, cells = row
        line = self._form.layout.separator.join(cells)[:QUOTED]
        if cell == NO_CELL:
            return f"line {number}, {line!r}: no column {at}; it has {len(cells)}"
        return (
            f"line {number}, {line!r}: {cell[:QUOTED]!r} is not a number; write one there or"
            " nothing"
        )

    def leave_out_broken_end(self) -> list[str]:
        """Leave out a last row that lacks a cell, as where a recorder stopped; note it."""
        last = len(self) - 1
        cut = [at for at, cell in self._wrong.items() if cell.row == last > 0]
        if not any(self._wrong[at].text == NO_CELL for at in cut):
            return []
        for at in cut:
            del self._wrong[at]
        for values in self._values:
            del values[last:]
        return [f"line {self._lines.pop()}, the last one, breaks off, and is left out"]

    def column(self, at: int) -> Floats:
        """Return the values of a column."""
        return np.frombuffer(self._values[at], np.float64)

    def checked_column(self, at: int) -> Floats:
        """Return the values of a signal. Raises SourceError for a cell that is no number."""
        if at in self._wrong:
            raise SourceError(f"{self._path}: {self._wrong[at].fault}")
        return self.column(at)

    def holds_numbers(self, at: int, title: str) -> bool:
        """Return whether a column is a signal.

        Columns of remarks are empty where they hold none, and a separator may end each line.
        """
        if self._form.kinds[at] != NUMBER:
            return False
        empty = not np.isfinite(self.column(at)).any()
        return not empty or bool(title and at not in self._wrong) or len(self._form.kinds) == 1

    def place(self, row: int) -> str:
        """Return the place of a row for people, with the text of a cell that is no value in it."""
        texts = (f", {cell.text[:QUOTED]!r}" for cell in self._wrong.values() if cell.row == row)
        return f"row {row + 1} (line {self._lines[row]}){next(texts, '')}"


def read(path: Path) -> SignalFile:
    """Open a table. Its signals are the columns of numbers. Raises SourceError."""
    lines = _lines(path)
    first = list(islice(lines, FIRST_LINES))
    form = recognise(first, path)
    above, start = _above(first, form), form.start
    titles, rate_hz = read_titles(above, form.layout.split, len(form.kinds)), stated_rate(above)
    if not any(titles):
        tops = [form.layout.numbers(form.layout.split(line)) for line in first[start : start + 3]]
        if (stated_hz := _rate_of_wristband(tops)) is not None:
            start, rate_hz = start + 2, stated_hz
    table = TextTable(form, path)
    for rows in _rows(form, chain(first[start:], lines), start):
        table.add(rows)
    notes = table.leave_out_broken_end()
    numbers = [at for at, title in enumerate(titles) if table.holds_numbers(at, title)]
    times = [at for at, kind in enumerate(form.kinds) if kind == TIME]
    lengths = dict.fromkeys(numbers, len(table))
    file = column_file(path, titles, lengths, table.column, times, rate_hz, table.place, notes)
    return replace(file, values=table.checked_column)


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file without their ends. Raises SourceError for one that is too long."""
    check_regular(path)
    with path.open(encoding=text_encoding(path), errors="replace") as file:
        for number, line in enumerate(iter(partial(file.readline, MOST_CHARACTERS), ""), 1):
            if len(line) == MOST_CHARACTERS:
                raise SourceError(
                    f"{path}: line {number}, {line[:QUOTED]!r}, has more than {MOST_CHARACTERS}"
                    " characters; a table of text has a row in each line"
                )
            yield line.rstrip("\n")


def _above(lines: Sequence[str], form: Form) -> list[str]:
    """Return the lines above a table, and the labels of its first row as a line of titles."""
    above = [line for line in lines[: form.start] if line.strip()]
    if form.layout.labelled:
        above.append(";".join(title for title, _ in labelled_numbers(lines[form.start])))
    return above


def _rate_of_wristband(rows: Sequence[Sequence[float | None]]) -> float | None:
    """Return the rate in Hz in a second row, below a begin as a Unix time in s; or None."""
    if len(rows) < 3 or any(len(set(row)) != 1 or None in row for row in rows[:2]):
        return None
    begin_s, rate_hz, value = (row[0] or 0.0 for row in rows)
    unix = UNIX_S[0] < begin_s < UNIX_S[1] and abs(value) < UNIX_S[0]
    return rate_hz if unix and rate_fault(rate_hz) is None else None


def _rows(form: Form, lines: Iterable[str], start: int) -> Iterator[list[_Row]]:
    """Yield the rows of a table with the numbers of their lines, some at once."""
    reader = form.layout.rows("" if is_comment(line) or line.isspace() else line for line in lines)
    while read := list(islice(reader, ROWS_AT_ONCE)):
        # A row in each line.
        numbered = enumerate(read, start + reader.line_num - len(read) + 1)
        yield [(number, cells) for number, cells in numbered if any(cells)]
