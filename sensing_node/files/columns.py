"""Columns of a CSV or NumPy file: the samples of a recording, and what stands beside them.

A unit in brackets after a column's name is the unit of its values: "ABP [mmHg]". An array
`rate_hz` of one value in an .npz is the rate.
"""

import csv
import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from protocol.wire.stream import first_repeated
from pulse_sensors.plausibility import RecordedColumn
from sensing_node.files.signals import ColumnKey, SignalFile, SignalInfo, SignalTable, split_unit

RATE = "rate_hz"


def read(path: Path) -> SignalFile:
    """Open a .csv, .txt, .npy or .npz file. Raises SourceError, and others for a damaged file.

    Its signals are the columns whose first value is a number, or the arrays of numbers.
    """
    if path.suffix.lower() in (".npy", ".npz"):
        signals = _numpy_signals(path)
        return SignalFile(path, tuple(signals), lambda keys: _load_numpy(path, keys))
    return SignalFile(path, tuple(_csv_signals(path)), lambda keys: _load_csv(path, keys))


def write(path: Path, table: SignalTable) -> list[str]:
    """Write a .csv or .npz file, with a column of times in s."""
    notes: list[str] = []
    grid = table.at_one_rate(notes)
    times_s = np.arange(len(grid)) / table.rate_hz
    titles = [f"{s.name} [{s.unit}]" if s.unit else s.name for s in table.signals]
    if path.suffix.lower() == ".npz":
        columns = dict(zip(titles, grid.T, strict=True))
        if len(columns) < len(titles):
            raise ValueError("two signals have one name")
        np.savez(path, **{"t [s]": times_s, RATE: np.float64(table.rate_hz)} | columns)
    else:
        with path.open("x", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(["t [s]", *titles])
            rows.writerows(np.column_stack([times_s, grid]).tolist())
    return notes


def _csv_signals(path: Path) -> list[SignalInfo]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        first = [name.strip() for name in next(rows, [])]
        following = next((row for row in rows if row), first)
    has_header = any(_number(name) is None for name in first)
    return [
        SignalInfo(number, *(split_unit(name) if has_header else ("", "")))
        for number, name in enumerate(first)
        if number < len(following) and _number(following[number] or "nan") is not None
    ]


def _numpy_signals(path: Path) -> list[SignalInfo]:
    with path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return [SignalInfo(number, "") for number in range(_table(loaded, path).shape[1])]
        with loaded:
            rate_hz = float(loaded[RATE]) if RATE in loaded and loaded[RATE].ndim == 0 else None
            return [
                SignalInfo(number, *split_unit(name), rate_hz)
                for number, name in enumerate(loaded)
                if name != RATE
            ]


def _place(column: ColumnKey, titles: Sequence[str]) -> int | None:
    """Return the number of a column, from its number, title, or title without the unit."""
    if isinstance(column, int):
        return column
    names = titles if column in titles else [split_unit(title)[0] for title in titles]
    return names.index(column) if column in names else None


def _distinct(found: Sequence[int | None], path: Path) -> list[int]:
    numbers = [number for number in found if number is not None]
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
            if isinstance(column, str) and _place(column, first) is None:
                raise SourceError(f"{path}: no column {column!r}; it has {', '.join(first)[:200]}")
            if isinstance(column, int) and column >= len(first):
                raise SourceError(f"{path}: no column {column}; it has {len(first)}")
        numbers = _distinct([_place(column, first) for column in columns], path)
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
        RecordedColumn(np.array(kept, np.float64), number, _name(names[number]), others, times)
        for kept, number in zip(values, numbers, strict=True)
    ]


def _name(title: str) -> str:
    return split_unit(title)[0]


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
            return named_columns(loaded, columns, path)


def named_columns(
    arrays: Mapping[str, NDArray[Any]], columns: Sequence[ColumnKey], path: Path
) -> list[RecordedColumn]:
    """Return some of the arrays of a file. Raises SourceError as a reader does."""
    names = list(arrays)
    for c in columns:
        if _place(c, names) not in range(len(names)):
            raise SourceError(f"{path}: no array {c!r}; it has {', '.join(names)[:200]}")
    numbers = _distinct([_place(c, names) for c in columns], path)
    wanted = [names[number] for number in numbers]
    found = [_vector(np.asarray(arrays[name]), path) for name in wanted]
    beside = {other: np.asarray(arrays[other]) for other in names if other not in wanted}
    lengths = {len(array) for array in found}
    if len(lengths) > 1:
        raise SourceError(f"{path}: the arrays {', '.join(wanted)} differ in length")
    rising = _rising(beside, lengths.pop())
    return [
        RecordedColumn(array, number, _name(name), tuple(beside), rising)
        for array, number, name in zip(found, numbers, wanted, strict=True)
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
    numbers = _distinct([each for each in columns if isinstance(each, int)], path)
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
