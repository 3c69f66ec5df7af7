"""Tables in text, as recorders, spreadsheets and sketches write them.

Lines above the table may state titles, units and rate (`text_head.py`). Columns are apart by
commas, semicolons, tabs, bars or spaces, with "." or "," before decimals, or each number has its
label: "IR=100004 RED=79995". Lines that begin with #, % or // are comments; an empty cell is a
missing sample.
"""

import csv
import math
import re
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, islice, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from protocol.errors import SourceError
from pulse_sensors.plausibility import RecordedColumn, stated_times
from sensing_node.files.bounds import check_regular, check_samples
from sensing_node.files.clock import time_of
from sensing_node.files.columns import column_file, numbers_of
from sensing_node.files.signals import (
    ColumnKey,
    SignalFile,
    rate_fault,
    text_encoding,
)
from sensing_node.files.text_head import is_comment, read_head

if TYPE_CHECKING:
    from _csv import Reader

# Tried in this order; of equals, the first is taken.
LABELS = "labels"
LAYOUTS = ("\t", ";", ",", "|", " ", LABELS)
# Lines among which a table begins, and lines from which its layout is recognised.
FIRST_LINES, SAMPLE_LINES, FEW_LINES = 500, 20, 8
MOST_CHARACTERS, QUOTED = 1 << 17, 60
ROWS_AT_ONCE = 10_000
# In place of a cell that a row lacks.
NO_CELL = "\0"
# What a column holds.
NUMBER, TIME, TEXT, EMPTY = "number", "time", "text", "empty"
MISSING = frozenset(("", "-", "--", "na", "n/a", "#n/a", "null", "none", "?"))
# Unix times of 2001 to 2096 in s.
UNIX_S = (1e9, 4e9)
# Numbers with marks between thousands, by the mark before their decimals.
_GROUPED = {
    ".": re.compile(r"[-+]?\d{1,3}(?:[,'\u00a0\u202f ]\d{3})+(?:\.\d*)?"),
    ",": re.compile(r"[-+]?[1-9]\d{0,2}(?:[.'\u00a0\u202f ]\d{3})+(?:,\d*)?"),
}
_BETWEEN_THOUSANDS = {
    ".": re.compile("[,'\u00a0\u202f ]"),
    ",": re.compile("[.'\u00a0\u202f ]"),
}
_LABELLED = re.compile(
    r"[\"']?([^\W\d][\w .%/()\[\]-]*?)[\"']?\s*[=:]\s*([-+]?\d+(?:[.,]\d+)?(?:e[-+]?\d+)?)"
    r"(?:\s*([^\W\d]\w*)(?!\s*[=:\w]))?",
    re.IGNORECASE,
)


class Layout(NamedTuple):
    """Layout of a table: its separator, the mark before decimals, and labels in its rows."""

    separator: str
    decimal: str
    labelled: bool = False

    def split(self, line: str) -> list[str]:
        """Return the cells of a line; empty ones at its end are left out."""
        # Titles in columns of a fixed width have spaces themselves.
        fixed = self.separator == " " and "  " in line.strip()
        cells = re.split(" {2,}", line.strip()) if fixed else self.row(line)
        while cells and not cells[-1].strip():
            cells.pop()
        return [cell.strip(" '") for cell in cells]

    def row(self, line: str) -> list[str]:
        """Return the cells of a line, as they are."""
        return next(self.rows([line]), [])

    def rows(self, lines: Iterable[str]) -> "Reader":
        """Return the rows of lines; one of an empty line is empty."""
        if self.labelled:
            labelled = ((line, _pairs_of(line)) for line in lines)
            lines = (";".join(n for _, n in pairs) if pairs else line for line, pairs in labelled)
        if self.separator == " ":
            # Of several spaces in a row, one separates.
            lines = (line.strip() for line in lines)
        return csv.reader(lines, delimiter=self.separator, skipinitialspace=self.separator in " ,")

    def number(self, text: str) -> float | None:
        """Return the number in a cell, NaN in one of a missing sample; None for another text."""
        plain = text.strip(" \t'\"\u00a0")
        if _GROUPED[self.decimal].fullmatch(plain):
            plain = _BETWEEN_THOUSANDS[self.decimal].sub("", plain)
        try:
            return float(plain if self.decimal == "." else plain.replace(",", "."))
        except ValueError:
            return math.nan if plain.lower() in MISSING else None

    def numbers(self, cells: Sequence[str]) -> list[float | None]:
        """Return the number of each cell."""
        try:
            if self.decimal == ",":
                if any("." in cell for cell in cells):
                    raise ValueError
                return [float(cell.replace(",", ".")) for cell in cells]
            return list(map(float, cells))
        except ValueError:
            return [self.number(cell) for cell in cells]


class Wrong(NamedTuple):
    """A cell that is no value: its row from 0, its text, and its fault for people."""

    row: int
    text: str
    fault: str


class TextTable(NamedTuple):
    """Values of a table by column; NaN are missing.

    lines: number of each row's line in the file. wrong: first cell of a column that is no value.
    """

    values: "list[array[float]]"
    lines: "array[int]"
    wrong: dict[int, Wrong]

    def place(self, row: int) -> str:
        """Return the place of a row for people, with the text of a cell that is no value in it."""
        texts = (f", {cell.text[:QUOTED]!r}" for cell in self.wrong.values() if cell.row == row)
        return f"row {row + 1} (line {self.lines[row]}){next(texts, '')}"


def read(path: Path) -> SignalFile:
    """Open a table. Its signals are the columns of numbers. Raises SourceError."""
    lines = _lines(path)
    first = list(islice(lines, FIRST_LINES))
    layout, start, kinds = _recognise(first, path)
    above = [line for line in first[:start] if line.strip()]
    if layout.labelled:
        above.append(";".join(title for title, _ in _pairs_of(first[start])))
    head = read_head(above, layout.split, len(kinds))
    rate_hz = head.rate_hz
    if not any(head.titles):
        rows = [layout.numbers(layout.split(line)) for line in first[start : start + 3]]
        begin_s, rate_hz = _begin_and_rate(rows) or (None, rate_hz)
        start += 2 * (begin_s is not None)
    table = _parse(layout, chain(first[start:], lines), start, kinds, path)
    notes = _cut(table)
    arrays = [np.frombuffer(values, np.float64) for values in table.values]
    titles = head.titles
    numbers = [
        at
        for at, kind in enumerate(kinds)
        # Columns of remarks are empty where they hold none, and a separator may end each line.
        if kind == NUMBER
        and (
            bool(np.isfinite(arrays[at]).any())
            or (titles[at] and at not in table.wrong)
            or len(kinds) == 1
        )
    ]
    file = column_file(
        path,
        titles,
        dict.fromkeys(numbers, len(table.lines)),
        arrays.__getitem__,
        [at for at, kind in enumerate(kinds) if kind == TIME],
        place=table.place,
        notes=tuple(notes),
    )

    def load(keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
        for at in numbers_of(keys, titles, path):
            if at in table.wrong and kinds[at] == NUMBER:
                raise SourceError(f"{path}: {table.wrong[at].fault}")
        return file.load(keys)

    # Times in the table state the rate better than a line above it.
    clocked = any(stated_times(file.load([at])[0]) for at in numbers)
    signals = [each._replace(rate_hz=None if clocked else rate_hz) for each in file.signals]
    return replace(file, load=load, signals=tuple(signals))


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


def _recognise(lines: Sequence[str], path: Path) -> tuple[Layout, int, list[str]]:
    """Return a table's layout, the place of its first row, and the kind of each column.

    Raises SourceError for text that is no table.
    """
    plain = [at for at, line in enumerate(lines) if line.strip() and not is_comment(line)]
    if not plain:
        raise SourceError(f"{path}: holds no line of values")
    texts = [lines[at] for at in plain]
    _, layout, kinds = max((_tried(each, texts) for each in LAYOUTS), key=lambda tried: tried[0])
    rows = [layout.row(line) for line in texts]
    first = _first_row(rows, kinds, layout)
    if first is None:
        raise SourceError(
            f"{path}: holds no signal of numbers: line {plain[0] + 1}, {texts[0][:QUOTED]!r}, is no"
            " row of a table, which has numbers apart by commas, semicolons, tabs or spaces"
        )
    start = plain[first]
    widest = len(layout.split(lines[start - 1])) if start else 0
    while kinds[-1] == EMPTY and len(kinds) > widest:
        kinds.pop()
    return layout, start, [NUMBER if kind == EMPTY else kind for kind in kinds]


def _first_row(rows: Sequence[Sequence[str]], kinds: Sequence[str], layout: Layout) -> int | None:
    """Return the place of a table's first row among the rows of a text, or None."""
    whole = [at for at, row in enumerate(rows) if _is_row(row, kinds, layout)]
    numbers = [sum(layout.number(cell) is not None for cell in row) for row in rows]
    for at in whole:
        # A lone number above titles is none; one below titles is, whatever follows.
        if at + 1 in (len(rows), *whole) or numbers[at + 1] or (at and not numbers[at - 1]):
            break
    else:
        return whole[0] if whole else None
    if not rows[at][0].strip() and at + 1 in whole and rows[at + 1][0].strip():
        # Counts of samples between titles and values.
        return at + 1
    # A row with a wrong cell right below titles is a row all the same.
    alike = at > 1 and len(rows[at - 2]) == len(rows[at - 1]) == len(kinds)
    return at - 1 if alike and numbers[at - 1] > numbers[at - 2] == 0 else at


def _tried(separator: str, lines: Sequence[str]) -> tuple[tuple[float, ...], Layout, list[str]]:
    """Return how well a separator serves for lines, with the layout and the kinds of columns."""
    labelled = separator == LABELS
    layout = Layout(";" if labelled else separator, ".", labelled)
    # Of a few lines, a wrong one is not to weigh as much as the others.
    begin = len(lines) // (2 if len(lines) > FEW_LINES else 4)
    rows = [layout.row(line) for line in lines[begin:][-SAMPLE_LINES:]]
    layout = layout._replace(decimal=_decimal([cell for row in rows for cell in row], separator))
    counts = Counter(map(len, rows))
    width = max(counts, key=lambda each: (counts[each], each))
    columns = zip(*(row for row in rows if len(row) == width), strict=True)
    kinds = [_kind(cells, layout) for cells in columns]
    fits = sum(_is_row(row, kinds, layout) for row in rows)
    first = next((n for n, line in enumerate(lines) if _is_row(layout.row(line), kinds, layout)), 0)
    title = lines[first - 1] if first else ""
    listed = layout.separator in title
    # A comma in numbers alone, and not between titles, is a decimal comma.
    apart = not first or listed or ("," not in title if layout.decimal == "," else width == 1)
    score = (2 * fits >= len(rows), apart, fits, -kinds.count(TEXT), width)
    return (*score, listed and separator in "\t;|"), layout, kinds


def _kind(cells: Sequence[str], layout: Layout) -> str:
    """Return what most cells of a column hold."""
    if not any(map(str.strip, cells)):
        return EMPTY
    if 2 * sum(layout.number(cell) is not None for cell in cells) >= len(cells):
        return NUMBER
    return TIME if 2 * sum(time_of(cell) is not None for cell in cells) >= len(cells) else TEXT


def _is_row(row: Sequence[str], kinds: Sequence[str], layout: Layout) -> bool:
    """Return whether a row has a number, or nothing, in each column of numbers."""
    numbers = [at for at, kind in enumerate(kinds) if kind == NUMBER]
    held = [row[at] for at in numbers if at < len(row)]
    whole = len(held) == len(numbers) > 0 and any(map(str.strip, held))
    return whole and None not in map(layout.number, held)


def _decimal(cells: Sequence[str], separator: str) -> str:
    """Return the mark before the decimals of numbers; the other one may be between thousands."""
    commas = [cell.strip() for cell in cells if "," in cell]
    if not commas or any("." in cell.rpartition(",")[2] for cell in commas):
        return "."
    if any("." in cell for cell in commas):
        return ","
    grouped = all(_GROUPED["."].fullmatch(cell) for cell in commas)
    points = any("." in cell and not _GROUPED[","].fullmatch(cell.strip()) for cell in cells)
    return "." if grouped and (points or separator == ",") else ","


def _begin_and_rate(rows: Sequence[Sequence[float | None]]) -> tuple[float, float] | None:
    """Return the Unix time in s and the rate in Hz of a wristband's first two rows, or None."""
    if len(rows) < 3 or any(len(set(row)) != 1 or None in row for row in rows[:2]):
        return None
    begin_s, rate_hz, value = (row[0] or 0.0 for row in rows)
    unix = UNIX_S[0] < begin_s < UNIX_S[1] and abs(value) < UNIX_S[0]
    return (begin_s, rate_hz) if unix and rate_fault(rate_hz) is None else None


def _pairs_of(line: str) -> list[tuple[str, str]]:
    """Return the titles and numbers of a line with labels; the time before "->" is one of them."""
    found = [
        (f"{label} [{unit}]" if unit else label, number)
        for label, number, unit in _LABELLED.findall(line)
    ]
    rest = _LABELLED.sub("", line).strip(" \t,;|{}[]\"'")
    if rest.endswith("->"):
        return [("time", rest.removesuffix("->").strip()), *found]
    return [] if rest else found


def _parse(
    layout: Layout, lines: Iterable[str], start: int, kinds: Sequence[str], path: Path
) -> TextTable:
    """Return the values of a table. Raises SourceError for more of them than are read."""
    table = TextTable([array("d") for _ in kinds], array("q"), {})
    reader = layout.rows("" if is_comment(line) or line.isspace() else line for line in lines)
    while read := list(islice(reader, ROWS_AT_ONCE)):
        # A row in each line.
        numbered = enumerate(read, start + reader.line_num - len(read) + 1)
        batch = [(number, row) for number, row in numbered if any(row)]
        before = len(table.lines)
        table.lines.extend(number for number, _ in batch)
        check_samples(path, len(table.lines) * len(kinds))
        columns = list(zip_longest(*(row for _, row in batch), fillvalue=NO_CELL))
        columns += [(NO_CELL,) * len(batch)] * (len(kinds) - len(columns))
        for at, (kind, cells) in enumerate(zip(kinds, columns, strict=False)):
            if kind == TEXT:
                continue
            values = layout.numbers(cells) if kind == NUMBER else list(map(time_of, cells))
            if None in values and at not in table.wrong:
                n = values.index(None)
                number, row = batch[n]
                fault = f"{cells[n][:QUOTED]!r} is not a number; write one there or nothing"
                if cells[n] == NO_CELL:
                    fault = f"no column {at}; it has {len(row)}"
                line = layout.separator.join(row)[:QUOTED]
                fault = f"line {number}, {line!r}: {fault}"
                table.wrong[at] = Wrong(before + n, cells[n], fault)
            table.values[at].extend(math.nan if value is None else value for value in values)
    return table


def _cut(table: TextTable) -> list[str]:
    """Leave out a last row that breaks off; return a note of it."""
    cut = [at for at, cell in table.wrong.items() if cell.row and cell.row == len(table.lines) - 1]
    if not any(table.wrong[at].text == NO_CELL for at in cut):
        return []
    for at in cut:
        del table.wrong[at]
    for values in table.values:
        del values[len(table.lines) - 1 :]
    return [f"line {table.lines.pop()}, the last one, breaks off, and is left out"]
