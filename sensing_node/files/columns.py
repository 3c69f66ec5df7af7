"""Files of columns, of which some are times.

Tables in text, NumPy, MATLAB and Parquet files share this. A unit in brackets after a column's
title is the unit of its values: "ABP [mmHg]".
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensing_node.files.clock import are_times, repaired
from sensing_node.files.recording_plausibility import never_falls
from sensing_node.files.signals import SignalFile, SignalInfo, clean, split_unit

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

    numbers: the columns of numbers, with the number of samples of each. column: returns the values
    of one. times: columns of times in s, which are no numbers in the file. rate_hz: as stated apart
    from the columns. place: returns the place of a sample in the file for people.
    """
    titles = list(map(clean, titles))
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

    signals = tuple(
        SignalInfo(number, *split_unit(titles[number]), rate_hz, samples)
        for number, samples in numbers.items()
    )
    return SignalFile(
        *(path, signals, column, tuple(notes)),
        titles=tuple(titles),
        labels=tuple(labels),
        clocks=clocks,
    )
