"""Parquet files: columns of numbers, with units in the fields' metadata, and times in a column."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import parquet

from pulse_sensors.plausibility import SECONDS, RecordedColumn
from sensing_node.files.columns import named_columns
from sensing_node.files.signals import (
    ColumnKey,
    Floats,
    SignalFile,
    SignalInfo,
    SignalTable,
    split_unit,
)

TIME = "t_s"
# Key of the file's metadata with the Unix time of its begin.
BEGIN = "begin_unix_ns"
# Keys of other programs and of exported tables, which describe columns.
DESCRIPTIONS = ("pandas", "ARROW:", "telepulse.", "creator", BEGIN)


def read(path: Path) -> SignalFile:
    """Open a file. Raises errors of pyarrow for a damaged one."""
    with parquet.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
    units = [
        split_unit(field.name)[1]
        or (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
        for field in schema
    ]
    signals = [
        SignalInfo(number, split_unit(field.name)[0], units[number], samples=rows)
        for number, field in enumerate(schema)
        if _is_number(field.type)
    ]

    def load(keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
        with parquet.ParquetFile(path) as opened:
            table = opened.read()
        arrays, times = dict[int, Floats](), dict[int, Floats]()
        for number, field in enumerate(schema):
            if _is_number(field.type):
                column = table.column(number).cast(pyarrow.float64(), safe=False)
                arrays[number] = np.asarray(column.to_numpy(), dtype=np.float64)
            elif (seconds := _seconds(field.type)) is not None:
                column = table.column(number).cast(pyarrow.int64()).cast(pyarrow.float64(), False)
                times[number] = np.asarray(column.to_numpy()) * seconds
        return named_columns(path, schema.names, arrays, keys, times)

    texts = {
        key.decode("utf-8", "replace"): text.decode("utf-8", "replace")
        for key, text in (schema.metadata or {}).items()
    }
    begin = texts.get(BEGIN, "")
    return SignalFile(
        path,
        tuple(signals),
        load,
        int(begin) if begin.isdecimal() else None,
        metadata={key: text for key, text in texts.items() if not key.startswith(DESCRIPTIONS)},
    )


def _is_number(kind: Any) -> bool:
    types = pyarrow.types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _seconds(kind: Any) -> float | None:
    """Return the unit of a type of times, in s; None for another type."""
    types = pyarrow.types
    return SECONDS[kind.unit] if types.is_timestamp(kind) or types.is_duration(kind) else None


def write(path: Path, table: SignalTable) -> list[str]:
    """Write a file with a column of times; missing samples are null."""
    notes: list[str] = []
    grid = table.at_one_rate(notes)
    fields = [pyarrow.field(TIME, pyarrow.float64(), metadata={"unit": "s"})]
    arrays = [pyarrow.array(np.arange(len(grid)) / table.rate_hz)]
    for signal, values in zip(table.signals, grid.T, strict=True):
        fields.append(pyarrow.field(signal.name, pyarrow.float64(), metadata={"unit": signal.unit}))
        arrays.append(pyarrow.array(values, mask=np.isnan(values)))
    begin = {} if table.begin_ns is None else {BEGIN: str(table.begin_ns)}
    schema = pyarrow.schema(fields, metadata={**table.metadata, **begin})
    parquet.write_table(pyarrow.table(arrays, schema=schema), path, compression="zstd")
    return notes
