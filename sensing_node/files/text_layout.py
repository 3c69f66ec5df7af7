"""Layout of a table in text: how its cells are apart, where it begins, and what its columns hold.

Each separator is tried on some of the lines, and the layout that serves best is taken. The csv
module's sniffer and pandas assume one form of numbers, and no lines above a table.
"""

import csv
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from protocol.errors import SourceError
from pulse_sensors.text_lines import MEASURED, labelled_numbers
from sensing_node.files.clock import time_of

if TYPE_CHECKING:
    from _csv import Reader

# What a column holds.
NUMBER, TIME, TEXT, EMPTY = "number", "time", "text", "empty"
# Tried in this order; of equals, the first is taken.
LABELS = "labels"
SEPARATORS = ("\t", ";", ",", "|", " ", LABELS)
# Cell of a line with labels that the table lacks.
OTHER_LABELS = "other labels"
# Lines from which a layout is recognised, and lines of which one may be wrong.
SAMPLE_LINES, FEW_LINES = 20, 8
# Characters of a line or a cell in a refusal.
QUOTED = 60
COMMENTS = ("#", "%", "//")
MISSING = frozenset(("", "-", "--", "na", "n/a", "#n/a", "null", "none", "?"))
# Numbers with marks between thousands, by the mark before the decimals.
_GROUPED = {
    ".": re.compile(r"[-+]?\d{1,3}(?:[,'\u00a0\u202f ]\d{3})+(?:\.\d*)?"),
    ",": re.compile(r"[-+]?[1-9]\d{0,2}(?:[.'\u00a0\u202f ]\d{3})+(?:,\d*)?"),
}


class Layout(NamedTuple):
    """Layout of lines: their separator, the mark before decimals, and the labels beside numbers."""

    separator: str
    decimal: str
    labels: tuple[str, ...] = ()

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
        if self.labels:
            lines = map(self._unlabelled, lines)
        if self.separator == " ":
            # Of several spaces in a row, one separates.
            lines = (line.strip() for line in lines)
        return csv.reader(lines, delimiter=self.separator, skipinitialspace=self.separator in " ,")

    def _unlabelled(self, line: str) -> str:
        """Return the numbers of a line by label; one cell more for other labels."""
        numbers = dict(_titled_numbers(line))
        more = [OTHER_LABELS] if set(numbers) - set(self.labels) else []
        found = [numbers.get(label, "") for label in self.labels]
        return ";".join(found + more) if numbers else line

    def measured(self, text: str) -> tuple[str, str]:
        """Return the number of a cell, as it stands there, and its unit or nothing."""
        found = MEASURED.fullmatch(text.strip())
        return (found[1], found[2]) if found else (text, "")

    def number(self, text: str) -> float | None:
        """Return the number in a cell, NaN in one of a missing sample; None for another text."""
        plain = self.measured(text)[0].strip(" \t'\"\u00a0")
        if _GROUPED[self.decimal].fullmatch(plain):
            plain = re.sub(rf"[^\d{self.decimal}+-]", "", plain)
        try:
            return float(plain if self.decimal == "." else plain.replace(",", "."))
        except ValueError:
            return math.nan if plain.lower() in MISSING else None

    def numbers(self, cells: Sequence[str]) -> list[float | None]:
        """Return the number of each cell."""
        try:
            if self.decimal == ".":
                return list(map(float, cells))
            if not any("." in cell for cell in cells):
                return [float(cell.replace(",", ".")) for cell in cells]
        except ValueError:
            pass
        return [self.number(cell) for cell in cells]


class Form(NamedTuple):
    """Form of a table: its layout, the kind of each column, and the line of its first row."""

    layout: Layout
    kinds: list[str]
    start: int = 0

    def is_row(self, cells: Sequence[str]) -> bool:
        """Return whether cells are a row: a number, or nothing, in each column of numbers."""
        numbers = [at for at, kind in enumerate(self.kinds) if kind == NUMBER]
        held = [cells[at] for at in numbers if at < len(cells)]
        whole = len(held) == len(numbers) > 0 and any(map(str.strip, held))
        return whole and None not in map(self.layout.number, held)


def is_comment(line: str) -> bool:
    """Return whether a line is a comment."""
    return line.lstrip().startswith(COMMENTS)


def _titled_numbers(line: str) -> list[tuple[str, str]]:
    """Return the labels of a line, with their units, and the numbers."""
    return [
        (f"{number.label} [{number.unit}]" if number.unit else number.label, number.text)
        for number in labelled_numbers(line)
    ]


def _refuse_kinds(lines: Sequence[str], path: Path) -> None:
    """Refuse lines of several kinds, or of several values each. Raises SourceError."""
    kinds = Counter(", ".join(sorted(label for label, _ in _titled_numbers(x))) for x in lines)
    with suppress(ValueError, RecursionError):
        rows = [row for row in map(json.loads, lines) if isinstance(row, dict)]
        held = [pair for row in rows for pair in row.items()]
        nested = {f"{k!r} of {len(v)}": 0 for k, v in held if isinstance(v, list | dict) and v}
        if nested:
            raise SourceError(
                f"{path}: each line is JSON with lists or tables, {', '.join(nested)[:QUOTED]}:"
                " write a row for each value, as pandas.json_normalize with record_path does"
            )
        texts = Counter(f"{key} {value}" for key, value in held if isinstance(value, str))
        repeated = {text: count for text, count in texts.items() if 1 < count < len(lines)}
        kinds = Counter(repeated) if len(repeated) > 1 else kinds
    if len(kinds) > 1 and "" not in kinds and min(kinds.values()) > 1:
        listed = "; ".join(kinds)[: 2 * QUOTED]
        raise SourceError(
            f"{path}: has rows of several kinds: {listed}; keep one kind in a file of its own"
        )


def recognise(lines: Sequence[str], path: Path) -> Form:
    """Return the form of the table in a file's first lines. Raises SourceError without one."""
    plain = [at for at, line in enumerate(lines) if line.strip() and not is_comment(line)]
    if not plain:
        raise SourceError(f"{path}: holds no line of values")
    texts = [lines[at] for at in plain]
    _refuse_kinds(texts[len(texts) // 4 :][-SAMPLE_LINES:], path)
    _, form = max((_tried(each, texts) for each in SEPARATORS), key=lambda tried: tried[0])
    first = _first_row([form.layout.row(line) for line in texts], form)
    if first is None:
        raise SourceError(
            f"{path}: holds no signal of numbers: line {plain[0] + 1}, {texts[0][:QUOTED]!r}, is no"
            " row of a table, which has numbers apart by commas, semicolons, tabs or spaces"
        )
    start = plain[first]
    titles = len(form.layout.split(lines[start - 1])) if start else 0
    kinds = list(form.kinds)
    while kinds[-1] == EMPTY and len(kinds) > titles:
        kinds.pop()
    return Form(form.layout, [NUMBER if kind == EMPTY else kind for kind in kinds], start)


def _tried(separator: str, lines: Sequence[str]) -> tuple[tuple[float, ...], Form]:
    """Return how well a separator serves for lines, and the form that they have by it."""
    # Of a few lines, a wrong one is not to weigh as much as the others.
    begin = len(lines) // (2 if len(lines) > FEW_LINES else 4)
    sample = lines[begin:][-SAMPLE_LINES:]
    layout = Layout(separator, ".")
    if separator == LABELS:
        labels = Counter(tuple(label for label, _ in _titled_numbers(line)) for line in sample)
        layout = Layout(";", ".", labels.most_common(1)[0][0])
    rows = [layout.row(line) for line in sample]
    layout = layout._replace(decimal=_decimal([cell for row in rows for cell in row], separator))
    counts = Counter(map(len, rows))
    width = max(counts, key=lambda each: (counts[each], each))
    columns = zip(*(row for row in rows if len(row) == width), strict=True)
    form = Form(layout, [_kind(cells, layout) for cells in columns])
    return _score(form, rows, lines), form


def _score(form: Form, rows: Sequence[Sequence[str]], lines: Sequence[str]) -> tuple[float, ...]:
    """Return how well a form serves for a sample of rows, and for the titles above them."""
    layout, width = form.layout, len(form.kinds)
    fits = sum(map(form.is_row, rows))
    first = next((at for at, line in enumerate(lines) if form.is_row(layout.row(line))), 0)
    title = lines[first - 1] if first else ""
    listed = layout.separator in title
    # A comma in numbers alone, and not between titles, is a decimal comma.
    apart = (
        bool(layout.labels)
        or not first
        or listed
        or ("," not in title if layout.decimal == "," else width == 1)
    )
    most_fit = 2 * fits >= len(rows)
    texts = form.kinds.count(TEXT)
    return most_fit, apart, fits, -texts, width, listed and layout.separator in "\t;|"


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


def _kind(cells: Sequence[str], layout: Layout) -> str:
    """Return what most cells of a column hold."""
    if not any(map(str.strip, cells)):
        return EMPTY
    if 2 * sum(layout.number(cell) is not None for cell in cells) >= len(cells):
        return NUMBER
    return TIME if 2 * sum(time_of(cell) is not None for cell in cells) >= len(cells) else TEXT


def _first_row(rows: Sequence[Sequence[str]], form: Form) -> int | None:
    """Return the place of a table's first row among the rows of a text, or None."""
    whole = [at for at, row in enumerate(rows) if form.is_row(row)]
    numbers = [sum(form.layout.number(cell) is not None for cell in row) for row in rows]

    def begins(at: int) -> bool:
        # A lone number above titles is no row; one below titles is, whatever follows.
        last, above_row = at + 1 == len(rows), at + 1 in whole
        return last or above_row or bool(numbers[at + 1]) or bool(at and not numbers[at - 1])

    at = next(filter(begins, whole), None)
    if at is None:
        return whole[0] if whole else None
    if at + 1 in whole and not rows[at][0].strip() and rows[at + 1][0].strip():
        # Counts of samples between titles and values.
        return at + 1
    # A row with a wrong cell right below titles is a row all the same.
    wide = at > 1 and len(rows[at - 2]) == len(rows[at - 1]) == len(form.kinds)
    return at - 1 if wide and numbers[at - 1] > numbers[at - 2] == 0 else at
