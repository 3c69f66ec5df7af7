"""Files of columns: which one a name or number stands for, and which ones are times.

Tables in text, NumPy, MATLAB and Parquet files share this. A unit in brackets after a column's
title is the unit of its values: "ABP [mmHg]".
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from protocol.wire.stream import first_repeated
from pulse_sensors.plausibility import RecordedColumn, never_falls
from sensing_node.files.clock import are_times, repaired
from sensing_node.files.signals import ColumnKey, SignalFile, SignalInfo, split_unit

# Most columns that are kept as times.
MOST_CLOCKS = 4


def _row(number: int) -> str:
    return f"row {number + 1}"


def column_file(
    path: Path,
    titles: Sequence[str],
    numbers: Mapping[int, int],
    column: Callable[[int], NDArray[Any]],
    times: Sequence[int] = (),
    rate_hz: float | None = None,
    place: Callable[[int], str] = _row,
    notes: Sequence[str] = (),
) -> SignalFile:
    """Return a file whose columns are read one by one.

    Parameters
    ----------
    numbers : mapping of int to int
        The number of samples of each column of numbers.
    column : callable
        Return the values of a column, shape (samples,).
    times : sequence of int
        Columns of times in s, which are no numbers in the file.
    rate_hz : float, optional
        Rate that the file states apart from its columns.
    place : callable
        Return the place of a sample in the file for people.
    """
    labels = [f"{split_unit(t)[0]} [s]" if n in times else t for n, t in enumerate(titles)]

    @cache
    def clocks() -> tuple[dict[int, NDArray[Any]], list[str]]:
        found, notes = dict[int, NDArray[Any]](), list[str]()
        # Those with the name or the unit of times come first.
        stated = {n: n in times or are_times(*split_unit(labels[n])) for n in (*times, *numbers)}
        for number in sorted(stated, key=lambda n: not stated[n]):
            if len(found) == MOST_CLOCKS:
                break
            values = column(number)
            if stated[number]:
                label = labels[number] or str(number)
                if (mended := repaired(values.astype(np.float64), label, place)) is not None:
                    found[number], lines = mended
                    notes += lines
            elif len(values) and values[0] < values[-1] and never_falls(values):
                found[number] = values
        return found, notes

    def load(keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
        chosen = numbers_of(keys, titles, path)
        for number in chosen:
            if number not in numbers:
                raise SourceError(f"{path}: column {number}, {titles[number]!r}, holds no numbers")
        found, notes = clocks()
        others = tuple(label for number, label in enumerate(labels) if number not in chosen)
        beside = {n: values for n, values in found.items() if n not in chosen}
        columns = []
        for number in chosen:
            values = column(number)
            rising = {labels[n] or str(n): v for n, v in beside.items() if len(v) == len(values)}
            name = split_unit(titles[number])[0]
            columns.append(
                RecordedColumn(values, number, name, others, rising, tuple(notes) if rising else ())
            )
        return columns

    signals = tuple(
        SignalInfo(number, *split_unit(titles[number]), rate_hz, samples)
        for number, samples in numbers.items()
    )
    return SignalFile(path, signals, load, tuple(notes))


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
