"""Columns of a table: which one a name or number stands for, and which ones may be times.

CSV, NumPy and Parquet files share this. A unit in brackets after a column's title is the unit of
its values: "ABP [mmHg]".
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from protocol.wire.stream import first_repeated
from pulse_sensors.plausibility import RecordedColumn
from sensing_node.files.signals import ColumnKey, Floats, SignalTable, split_unit

# Title of the column of times in a file that telepulse writes.
TIMES = "t [s]"


def titles_of(table: SignalTable) -> list[str]:
    """Return the titles of a table's signals, with their units."""
    return [f"{s.name} [{s.unit}]" if s.unit else s.name for s in table.signals]


def in_seconds(title: str) -> str:
    """Return the title of a column of dates, whose Unix times are in s whatever its title says."""
    return f"{title} [s]"


def numbers_of(keys: Sequence[ColumnKey], titles: Sequence[str], path: Path) -> list[int]:
    """Return the numbers of columns from numbers, titles, or titles without their units.

    Raises SourceError for one that is not there or is named twice.
    """
    named = any(titles)
    numbers = []
    for key in keys:
        if isinstance(key, str):
            names = titles if key in titles else [split_unit(title)[0] for title in titles]
            number = names.index(key) if key in names else None
        else:
            number = key if key < len(titles) else None
        if number is None:
            held = ", ".join(titles)[:200] if named and isinstance(key, str) else len(titles)
            raise SourceError(f"{path}: no column {key!r}; it has {held}")
        numbers.append(number)
    repeated = first_repeated(numbers)
    if repeated is not None:
        raise SourceError(f"{path}: column {repeated} is named twice; a column is one channel")
    return numbers


def named_columns(
    path: Path,
    titles: Sequence[str],
    arrays: Mapping[int, NDArray[Any]],
    keys: Sequence[ColumnKey],
    times: Mapping[int, Floats] = {},
) -> list[RecordedColumn]:
    """Return some of the columns of a file, each with those beside it that may be its times.

    Parameters
    ----------
    arrays : mapping of int to ndarray, shape (samples,)
        The columns of numbers, by their numbers.
    times : mapping of int to ndarray, shape (samples,)
        Columns of times in s, which are no numbers in the file, by their numbers.
    """
    numbers = numbers_of(keys, titles, path)
    for number in numbers:
        if number not in arrays:
            raise SourceError(f"{path}: column {number}, {titles[number]!r}, holds no numbers")
    labels = [in_seconds(title) if n in times else title for n, title in enumerate(titles)]
    others = tuple(label for number, label in enumerate(labels) if number not in numbers)
    beside = {labels[n] or str(n): a for n, a in {**times, **arrays}.items() if n not in numbers}
    # NumPy warns of signalling NaN, which are missing samples like other NaN.
    with np.errstate(invalid="ignore"):
        return [
            RecordedColumn(
                np.ascontiguousarray(arrays[number], dtype=np.float64),
                number,
                split_unit(titles[number])[0],
                others,
                _rising(beside, len(arrays[number])),
            )
            for number in numbers
        ]


def _rising(arrays: Mapping[str, NDArray[Any]], length: int) -> dict[str, Floats]:
    """Return the arrays that have a given length and never fall."""
    return {
        name: array.astype(np.float64)
        for name, array in arrays.items()
        if len(array) == length
        and bool(np.isfinite(array).all())
        and bool(np.all(array[1:] >= array[:-1]))
    }
