"""One column of a CSV or NumPy file, and the times that stand beside it."""

import csv
import math
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError

# No unit of a recording takes a value of this size beyond what float32 holds.
LARGEST = 1e30


@dataclass(frozen=True, slots=True)
class RecordedColumn:
    """One column of a file.

    values: shape (samples,), finite. number: from 0. name: as in the file, empty where it has
    none. others: names of the other columns. rising: columns beside it whose values never fall,
    as times do not, by name or number.
    """

    values: NDArray[np.float64]
    number: int = 0
    name: str = ""
    others: tuple[str, ...] = ()
    rising: dict[str, NDArray[np.float64]] = field(default_factory=dict)


def load_column(path: Path, column: int | str) -> RecordedColumn:
    """Return one column of a file.

    Parameters
    ----------
    path : Path
        A .csv, .txt, .npy or .npz file.
    column : int or str
        Number from 0, or name.

    Raises
    ------
    SourceError
        Where the file cannot be read, or the column is missing or holds no usable numbers.
    """
    try:
        match path.suffix.lower():
            case ".csv" | ".txt":
                loaded = _load_csv(path, column)
            case ".npy" | ".npz":
                loaded = _load_numpy(path, column)
            case suffix:
                raise SourceError(f"{path}: {suffix or 'no suffix'} is not .csv, .npy or .npz")
    except SourceError:
        raise
    except FileNotFoundError:
        raise SourceError(f"{path}: no such recording") from None
    except Exception as error:  # damaged, it raises whatever NumPy, zipfile or csv stumble over
        lines = str(getattr(error, "strerror", None) or error).splitlines()
        reason = lines[0] if lines else type(error).__name__
        raise SourceError(f"{path}: cannot be read: {reason}") from None
    values = loaded.values
    if len(values) < 2:
        raise SourceError(f"{path}: number of samples is {len(values)}; it must be 2 or more")
    bad = np.flatnonzero(~(np.abs(values) <= LARGEST))
    if len(bad):
        count = "1 value is" if len(bad) == 1 else f"{len(bad)} values are"
        raise SourceError(
            f"{path}: {count} NaN or beyond {LARGEST:g}, the first is sample {bad[0]};"
            " cut or fill them"
        )
    return loaded


def _load_csv(path: Path, column: int | str) -> RecordedColumn:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        first = [name.strip() for name in next(rows, [])]
        if not first:
            raise SourceError(f"{path}: is empty, or its first line is")
        if isinstance(column, str) and column not in first:
            raise SourceError(f"{path}: no column {column!r}; it has {', '.join(first)[:200]}")
        number = first.index(column) if isinstance(column, str) else column
        if number >= len(first):
            raise SourceError(f"{path}: no column {column}; it has {len(first)}")
        has_header = isinstance(column, str) or not _is_number(first[number])
        rising = _Rising([place for place in range(len(first)) if place != number])
        values = []
        if not has_header:
            values.append(float(first[number]))
            rising.add(first)
        for row in rows:
            if row:
                values.append(_number(row, number, f"{path}: line {rows.line_num}"))
                rising.add(row)
    names = first if has_header else [""] * len(first)
    return RecordedColumn(
        np.array(values, dtype=np.float64),
        number,
        names[number],
        tuple(name for place, name in enumerate(names) if place != number),
        {names[place] or str(place): np.array(kept) for place, kept in rising.kept.items()},
    )


class _Rising:
    """The columns whose values have never fallen so far; a pulse's leaves within a beat."""

    def __init__(self, places: list[int]) -> None:
        self.kept: dict[int, list[float]] = {place: [] for place in places}

    def add(self, row: list[str]) -> None:
        """Take a row's values; what falls or is no time goes."""
        for place in list(self.kept):
            value = _time(row[place]) if place < len(row) else None
            kept = self.kept[place]
            if value is None or (kept and not value >= kept[-1]):
                del self.kept[place]
            else:
                kept.append(value)


def _time(text: str) -> float | None:
    """Return the finite number in a text, the Unix time of a date in ISO 8601, or None."""
    if _is_number(text):
        return float(text) if math.isfinite(float(text)) else None
    try:
        return datetime.fromisoformat(text.strip()).timestamp()
    except (ValueError, OverflowError):
        return None


def _number(row: list[str], position: int, where: str) -> float:
    """Return a row's number; `where` opens the error's line. Raises SourceError."""
    if position >= len(row):
        raise SourceError(f"{where}: no column {position}; it has {len(row)}")
    if not _is_number(row[position]):
        raise SourceError(f"{where}: {row[position][:40]!r} is not a number")
    return float(row[position])


def _load_numpy(path: Path, column: int | str) -> RecordedColumn:
    """Return a column of an .npy, or one of an .npz's arrays, as the file's first bytes decide."""
    with path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return _column_of(loaded, column, path)
        with loaded:
            names = list(loaded)
            if isinstance(column, int) and column < len(names):
                column = names[column]
            if column not in names:
                raise SourceError(f"{path}: no array {column!r}; it has {', '.join(names)[:200]}")
            chosen = _column_of(np.asarray(loaded[str(column)]), 0, path).values
            others = [name for name in names if name != column]
            beside = {name: np.asarray(loaded[name]) for name in others}
    return RecordedColumn(
        chosen, names.index(str(column)), str(column), tuple(others), _rising(beside, len(chosen))
    )


def _column_of(array: NDArray[Any], column: int | str, path: Path) -> RecordedColumn:
    if array.ndim not in (1, 2) or array.dtype.kind not in "iuf":
        raise SourceError(
            f"{path}: needs real numbers in one or two dimensions,"
            f" has {array.dtype} in {array.ndim}"
        )
    table = array[:, np.newaxis] if array.ndim == 1 else array
    if not isinstance(column, int) or column >= table.shape[1]:
        raise SourceError(f"{path}: no column {column!r}; it has {table.shape[1]}")
    others = [place for place in range(table.shape[1]) if place != column]
    # Some NaN are signals, at which NumPy would warn; they are counted with the others.
    with np.errstate(invalid="ignore"):
        values = np.ascontiguousarray(table[:, column], dtype=np.float64)
        rising = _rising({str(place): table[:, place] for place in others}, len(values))
    return RecordedColumn(values, column, others=("",) * len(others), rising=rising)


def _rising(arrays: dict[str, NDArray[Any]], length: int) -> dict[str, NDArray[np.float64]]:
    """Return those of the arrays that have that length and never fall."""
    return {
        name: array.astype(np.float64)
        for name, array in arrays.items()
        if array.shape == (length,)
        and array.dtype.kind in "iuf"
        and bool(np.isfinite(array).all())
        and bool(np.all(array[1:] >= array[:-1]))
    }


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
