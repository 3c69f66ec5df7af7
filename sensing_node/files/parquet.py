"""Parquet files: columns of numbers, with units in the fields' metadata, and times in a column."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import parquet

from sensing_node.files.bounds import check_samples
from sensing_node.files.column_kind import SECONDS
from sensing_node.files.columns import column_file
from sensing_node.files.signals import SignalFile, split_unit


def read(path: Path) -> SignalFile:
    """Open a file. Raises errors of pyarrow for a damaged one."""
    with parquet.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
    check_samples(path, rows)
    stated = [
        (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") for field in schema
    ]
    titles = [
        f"{name} [{unit}]" if unit and not split_unit(name)[1] else name
        for name, unit in zip(schema.names, stated, strict=True)
    ]

    @lru_cache(maxsize=1)
    def column(number: int) -> NDArray[Any]:
        name, kind = schema.names[number], schema.types[number]
        with parquet.ParquetFile(path) as opened:
            read = opened.read([name])
        # Columns may share a name, and one with a dot in it comes with those of its first part.
        shared = [n for n, each in enumerate(schema.names) if each == name].index(number)
        values = read.column(
            [n for n, each in enumerate(read.column_names) if each == name][shared]
        )
        if (seconds := _seconds(kind)) is not None:
            return np.asarray(values.cast(pyarrow.int64()).to_numpy()) * seconds
        if values.null_count or not pyarrow.types.is_floating(kind):
            values = values.cast(pyarrow.float64(), safe=False)
        return np.asarray(values.to_numpy())

    return column_file(
        path,
        titles,
        {n: rows for n, kind in enumerate(schema.types) if _is_number(kind)},
        column,
        [n for n, kind in enumerate(schema.types) if _seconds(kind) is not None],
    )


def _is_number(kind: Any) -> bool:
    types = pyarrow.types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _seconds(kind: Any) -> float | None:
    """Return the unit of a type of times, in s; None for another type."""
    types = pyarrow.types
    return SECONDS[kind.unit] if types.is_timestamp(kind) or types.is_duration(kind) else None
