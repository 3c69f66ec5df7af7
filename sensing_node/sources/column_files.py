"""Columns of a CSV or NumPy file: the samples of a recording, and what stands beside them."""

import csv
import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from protocol.errors import SourceError
from protocol.wire.stream import first_repeated
from pulse_sensors.plausibility import RecordedColumn, unusable_values

ColumnKey = Annotated[int, Field(ge=0)] | str
"""Number of a column from 0, or its name."""


def load_column(path: Path, column: ColumnKey) -> RecordedColumn:
    """Return one column of a file. Raises SourceError as `load_columns` does."""
    return load_columns(path, (column,))[0]


def load_columns(path: Path, columns: Sequence[ColumnKey]) -> list[RecordedColumn]:
    """Return columns of a file.

    Parameters
    ----------
    path : Path
        A .csv, .txt, .npy or .npz file.
    columns : sequence of int or str
        Numbers from 0, or names; each column once.

    Raises
    ------
    SourceError
        If the file cannot be read, or a column is missing, repeated, or has no usable numbers.
    """
    try:
        match path.suffix.lower():
            case ".csv" | ".txt":
                loaded = _load_csv(path, columns)
            case ".npy" | ".npz":
                loaded = _load_numpy(path, columns)
            case suffix:
                raise SourceError(f"{path}: {suffix or 'no suffix'} is not .csv, .npy or .npz")
    except SourceError:
        raise
    except FileNotFoundError:
        raise SourceError(f"{path}: no such recording") from None
    except Exception as error:  # NumPy, zipfile and csv raise many kinds for a damaged file
        lines = str(getattr(error, "strerror", None) or error).splitlines()
        reason = lines[0] if lines else type(error).__name__
        raise SourceError(f"{path}: cannot be read: {reason}") from None
    several = len(loaded) > 1
    for column in loaded:
        unusable = unusable_values(column.values)
        if unusable is not None:
            raise SourceError(f"{path}: {f'{column.title}: ' if several else ''}{unusable}")
    return loaded


def _distinct(numbers: list[int], path: Path) -> list[int]:
    repeated = first_repeated(numbers)
    if repeated is not None:
        raise SourceError(f"{path}: column {repeated} is named twice; a column is one channel")
    return numbers


def _load_csv(path: Path, columns: Sequence[ColumnKey]) -> list[RecordedColumn]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        first = [name.strip() for name in next(rows, [])]
        if not first:
            raise SourceError(f"{path}: is empty, or its first line is")
        for column in columns:
            if isinstance(column, str) and column not in first:
                raise SourceError(f"{path}: no column {column!r}; it has {', '.join(first)[:200]}")
            if isinstance(column, int) and column >= len(first):
                raise SourceError(f"{path}: no column {column}; it has {len(first)}")
        numbers = _distinct([c if isinstance(c, int) else first.index(c) for c in columns], path)
        has_header = any(isinstance(c, str) or _number(first[c]) is None for c in columns)
        # Columns whose values have not fallen yet; a pulse falls within a beat.
        rising: dict[int, list[float]] = {at: [] for at in range(len(first)) if at not in numbers}
        values: list[list[float]] = [[] for _ in numbers]

        def add(row: list[str]) -> None:
            where = f"{path}: line {rows.line_num}"
            for kept, number in zip(values, numbers, strict=True):
                if number >= len(row):
                    raise SourceError(f"{where}: no column {number}; it has {len(row)}")
                value = _number(row[number])
                if value is None:
                    raise SourceError(f"{where}: {row[number][:40]!r} is not a number")
                kept.append(value)
            for place, times in list(rising.items()):
                time = _time(row[place]) if place < len(row) else None
                if time is None or (times and not time >= times[-1]):
                    del rising[place]
                else:
                    times.append(time)

        if not has_header:
            add(first)
        for row in rows:
            if row:
                add(row)
    names = first if has_header else [""] * len(first)
    others = tuple(name for place, name in enumerate(names) if place not in numbers)
    times = {names[place] or str(place): np.array(kept) for place, kept in rising.items()}
    return [
        RecordedColumn(np.array(kept, dtype=np.float64), number, names[number], others, times)
        for kept, number in zip(values, numbers, strict=True)
    ]


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _time(text: str) -> float | None:
    """Return the finite number in a text, the Unix time of a date in ISO 8601, or None."""
    number = _number(text)
    if number is not None:
        return number if math.isfinite(number) else None
    try:
        return datetime.fromisoformat(text.strip()).timestamp()
    except (ValueError, OverflowError):
        return None


def _load_numpy(path: Path, columns: Sequence[ColumnKey]) -> list[RecordedColumn]:
    """Return columns of an .npy or arrays of an .npz; the file's first bytes decide which."""
    with path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return _table_columns(loaded, columns, path)
        with loaded:
            names = list(loaded)
            for c in columns:
                if c not in (range(len(names)) if isinstance(c, int) else names):
                    raise SourceError(f"{path}: no array {c!r}; it has {', '.join(names)[:200]}")
            numbers = _distinct(
                [c if isinstance(c, int) else names.index(c) for c in columns], path
            )
            wanted = [names[number] for number in numbers]
            arrays = [_vector(np.asarray(loaded[name]), path) for name in wanted]
            beside = {other: np.asarray(loaded[other]) for other in names if other not in wanted}
    lengths = {len(array) for array in arrays}
    if len(lengths) > 1:
        raise SourceError(f"{path}: the arrays {', '.join(wanted)} differ in length")
    rising = _rising(beside, lengths.pop())
    return [
        RecordedColumn(array, number, name, tuple(beside), rising)
        for array, number, name in zip(arrays, numbers, wanted, strict=True)
    ]


def _table(array: NDArray[Any], path: Path) -> NDArray[Any]:
    if array.ndim not in (1, 2) or array.dtype.kind not in "iuf":
        raise SourceError(
            f"{path}: needs real numbers in one or two dimensions,"
            f" has {array.dtype} in {array.ndim}"
        )
    return array[:, np.newaxis] if array.ndim == 1 else array


def _vector(array: NDArray[Any], path: Path) -> NDArray[np.float64]:
    """Return the first column of an array."""
    return _table_columns(array, (0,), path)[0].values


def _table_columns(
    array: NDArray[Any], columns: Sequence[ColumnKey], path: Path
) -> list[RecordedColumn]:
    table = _table(array, path)
    for column in columns:
        if not isinstance(column, int) or column >= table.shape[1]:
            raise SourceError(f"{path}: no column {column!r}; it has {table.shape[1]}")
    numbers = _distinct([column for column in columns if isinstance(column, int)], path)
    # NumPy warns of signalling NaN, which are refused later like other NaN.
    with np.errstate(invalid="ignore"):
        beside = {str(at): table[:, at] for at in range(table.shape[1]) if at not in numbers}
        rising, others = _rising(beside, len(table)), ("",) * len(beside)
        return [
            RecordedColumn(
                np.ascontiguousarray(table[:, number], dtype=np.float64),
                number,
                others=others,
                rising=rising,
            )
            for number in numbers
        ]


def _rising(arrays: dict[str, NDArray[Any]], length: int) -> dict[str, NDArray[np.float64]]:
    """Return the arrays that have a given length and never fall."""
    return {
        name: array.astype(np.float64)
        for name, array in arrays.items()
        if array.shape == (length,)
        and array.dtype.kind in "iuf"
        and bool(np.isfinite(array).all())
        and bool(np.all(array[1:] >= array[:-1]))
    }
