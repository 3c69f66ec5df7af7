"""Tables in text, as recorders, spreadsheets and sketches write them.

Lines above the table may state titles, units and rate (`text_head.py`). Columns are apart by
commas, semicolons, tabs, bars or spaces, with "." or "," before decimals, or each number has its
label: "IR=100004 RED=79995" (`text_layout.py`). Lines that begin with #, % or // are comments; an
empty cell is a missing sample.
"""

import math
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, islice, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from protocol.errors import SourceError
from pulse_sensors.text_lines import UNITS
from sensing_node.files.bounds import check_regular, check_samples
from sensing_node.files.clock import time_of
from sensing_node.files.column_kind import STATUS, conversion, counts, named_kind, words
from sensing_node.files.columns import column_file
from sensing_node.files.recording_plausibility import UNIX_S
from sensing_node.files.signals import (
    Floats,
    SignalFile,
    finite,
    rate_fault,
    split_unit,
    text_encoding,
)
from sensing_node.files.text_head import read_titles, stated_rate
from sensing_node.files.text_layout import (
    NUMBER,
    QUOTED,
    TEXT,
    TIME,
    Form,
    is_comment,
    recognise,
)

# Lines among which a table begins.
FIRST_LINES = 500
MOST_CHARACTERS = 1 << 17
ROWS_AT_ONCE = 10_000
# Most different texts of a column that are kept apart, and most kinds of rows.
MOST_TEXTS, MOST_KINDS, MOST_CYCLE = 1000, 16, 4
# Least share of rows of another kind than the one before.
LEAST_TURNS = 0.01
# Rows of another width that a table may have, and their share.
FEW_ODD, MOST_ODD = 2, 0.01
# Names of columns that state the kind of a row.
KIND_NAMES = {"type", "kind", "sensor", "channel", "device", "source", "stream", "id"}
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
    """Values of a table by column, NaN where missing, and the first cell of each that is none.

    texts: of a column of texts, the number of each text, which is its value. units: of a column of
    numbers, their unit; those in another unit are converted. widths: rows by their cells.
    """

    def __init__(self, form: Form, path: Path) -> None:
        self._form, self._path = form, path
        self._values = [array("d") for _ in form.kinds]
        self._lines = array("q")
        self._wrong: dict[int, Wrong] = {}
        self.texts: list[dict[str, int]] = [{} for _ in form.kinds]
        self.units: dict[int, str] = {}
        self.widths = Counter[int]()

    def __len__(self) -> int:
        return len(self._lines)

    def add(self, rows: Sequence[_Row]) -> None:
        """Add rows. Raises SourceError for more of them than are read."""
        kinds, first = self._form.kinds, len(self)
        self._lines.extend(number for number, _ in rows)
        check_samples(self._path, len(self) * len(kinds))
        width = len(kinds)
        self.widths.update(
            len(cells) if any(cells[width:]) else min(len(cells), width) for _, cells in rows
        )
        columns = list(zip_longest(*(cells for _, cells in rows), fillvalue=NO_CELL))
        columns += [(NO_CELL,) * len(rows)] * (len(kinds) - len(columns))
        for at, (kind, cells) in enumerate(zip(kinds, columns, strict=False)):
            values: list[float | None]
            if kind == NUMBER:
                values = self._form.layout.numbers(cells)
                if any(cell[-1:].isalpha() for cell in cells):
                    values = self._converted(at, cells, values)
            elif kind == TIME:
                values = list(map(time_of, cells))
            else:
                texts = self.texts[at]
                full = len(texts) >= MOST_TEXTS
                values = [texts.setdefault(c, len(texts)) if not full else -1 for c in cells]
            if None in values and at not in self._wrong:
                n = values.index(None)
                self._wrong[at] = Wrong(first + n, cells[n], self._fault(at, cells[n], rows[n]))
            self._values[at].extend(math.nan if value is None else value for value in values)

    def _converted(
        self, at: int, cells: Sequence[str], values: Sequence[float | None]
    ) -> list[float | None]:
        """Return values in the unit of the column's first one; None in one that it is not."""
        units = [self._form.layout.measured(cell)[1] for cell in cells]
        known = self.units.setdefault(at, next(filter(None, units), ""))
        factors = {unit: conversion(unit or known, known) for unit in set(units)}
        return [
            None if value is None or factors[unit] is None else value * (factors[unit] or 0)
            for value, unit in zip(values, units, strict=True)
        ]

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
        return finite(np.frombuffer(self._values[at], np.float64))

    def check(self, at: int) -> None:
        """Refuse a column with a cell that is no number. Raises SourceError."""
        if at in self._wrong:
            raise SourceError(f"{self._path}: {self._wrong[at].fault}")

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
    above, start = [line for line in first[: form.start] if line.strip()], form.start
    titles = list(form.layout.labels) or read_titles(above, form.layout.split, len(form.kinds))
    rate_hz = stated_rate(above)
    if not any(titles):
        tops = [form.layout.numbers(form.layout.split(line)) for line in first[start : start + 3]]
        if (stated_hz := _rate_of_wristband(tops)) is not None:
            start, rate_hz = start + 2, stated_hz
    table = TextTable(form, path)
    for rows in _rows(form, chain(first[start:], lines), start):
        table.add(rows)
    notes = table.leave_out_broken_end()
    _refuse_widths(table, form, path)
    scales = _scales(table, form, path)
    titles = [
        f"{title} [{unit}]" if unit and not split_unit(title)[1] else title
        for title, unit in zip(titles, map(table.units.get, range(len(titles))), strict=True)
    ]
    numbers = [at for at, title in enumerate(titles) if table.holds_numbers(at, title)]
    times = [at for at, kind in enumerate(form.kinds) if kind == TIME]
    kinds, count = _kinds_of_rows(table, form, titles), len(titles)
    if kinds:
        notes.append(f"its rows are of several kinds, each a signal: {', '.join(kinds)[:200]}")
    masks = list(kinds.values()) or [np.ones(len(table), bool)]
    named = list(kinds) or [""]

    def column(number: int) -> Floats:
        values = table.column(number % count) * scales.get(number % count, 1.0)
        return values[masks[number // count]] if kinds else values

    def checked(number: int) -> Floats:
        table.check(number % count)
        return column(number)

    # Each kind of row is a table beside the others.
    file = column_file(
        path,
        [_title_of(kind, titles[at], table.column(at)) for kind in named for at in range(count)],
        {n * count + at: int(mask.sum()) for n, mask in enumerate(masks) for at in numbers},
        column,
        [n * count + at for n in range(len(masks)) for at in times],
        rate_hz,
        table.place if not kinds else lambda row: f"row {row + 1} of its kind",
        notes,
    )
    return replace(file, values=checked)


def _title_of(kind: str, title: str, values: Floats) -> str:
    """Return the title of a column in the rows of a kind."""
    return f"{kind} {title}".strip() if title or not counts(values) else ""


def _refuse_widths(table: TextTable, form: Form, path: Path) -> None:
    """Refuse rows of several widths, which are of several kinds. Raises SourceError."""
    last = max((at for at, kind in enumerate(form.kinds) if kind != TEXT), default=0) + 1
    odd = {w: n for w, n in table.widths.items() if not last <= w <= len(form.kinds)}
    if sum(odd.values()) > max(FEW_ODD, MOST_ODD * len(table)):
        widths = ", ".join(f"{n} of {w} cells" for w, n in table.widths.most_common(4))
        raise SourceError(
            f"{path}: has rows of several kinds: {widths}; keep one kind in a file of its own"
        )


def _scales(table: TextTable, form: Form, path: Path) -> dict[int, Floats]:
    """Return the factors of columns whose unit stands beside them in each row.

    Raises SourceError where a unit cannot be converted into the first one.
    """
    scales = dict[int, Floats]()
    for at, texts in enumerate(table.texts):
        beside = [n for n in (at - 1, at + 1) if n in range(len(form.kinds))]
        beside = [n for n in beside if form.kinds[n] == NUMBER]
        units = [text for text in texts if text.strip() not in ("", NO_CELL)]
        if not units or not beside or not all(map(UNITS.fullmatch, units)):
            continue
        first = table.units[beside[0]] = units[0]
        # A row without its unit is a missing sample.
        factors = [conversion(text, first) if text in units else math.nan for text in texts]
        if None in factors:
            raise SourceError(
                f"{path}: its rows change their unit: {', '.join(units)[:QUOTED]}; keep one"
            )
        scales[beside[0]] = np.array(factors, float)[table.column(at).astype(int)]
    return scales


def _kinds_of_rows(
    table: TextTable, form: Form, titles: Sequence[str]
) -> dict[str, "np.ndarray[Any, np.dtype[np.bool_]]"]:
    """Return the rows of each kind, by the name of the kind that a column states; or nothing."""
    for at, title in enumerate(titles):
        values, texts = table.column(at), list(table.texts[at])
        known = list(map(float, np.unique(values[np.isfinite(values)][: 1 << 16])))
        stated = words(title)[-1] in KIND_NAMES if title else False
        turns = len(values) and np.count_nonzero(np.diff(values)) / len(values)
        if not 2 <= len(known) <= min(MOST_KINDS, len(values) // 4) or turns < LEAST_TURNS:
            continue
        if form.kinds[at] == TEXT:
            units = all(map(UNITS.fullmatch, texts))
            if not all(map(str.strip, texts)) or units or named_kind(title) == STATUS:
                continue
            names = [texts[int(value)] for value in known]
        else:
            small = len(known) <= MOST_CYCLE and set(known) <= set(range(MOST_KINDS))
            again = np.mean(values[len(known) :] == values[: -len(known)]) > 1 - MOST_ODD
            if not (stated or (small and again and not title)):
                continue
            names = [f"{title or 'kind'} {value:g}" for value in known]
        return {name: values == value for name, value in zip(names, known, strict=True)}
    return {}


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


def _rate_of_wristband(rows: Sequence[Sequence[float | None]]) -> float | None:
    """Return the rate in Hz in a second row, below a begin as a Unix time in s; or None."""
    if len(rows) < 3 or not rows[2] or any(len(set(row)) != 1 or None in row for row in rows[:2]):
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
