"""Parquet files: columns of numbers, with units in the fields' metadata, and times in a column."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow
from pyarrow import parquet

from pulse_sensors.plausibility import RecordedColumn
from sensing_node.files.columns import named_columns
from sensing_node.files.signals import ColumnKey, SignalFile, SignalInfo, SignalTable, split_unit

TIME = "t_s"


def read(path: Path) -> SignalFile:
    """Open a file. Raises errors of pyarrow for a damaged one."""
    with parquet.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
    names = [
        field.name
        for field in schema
        if pyarrow.types.is_integer(field.type) or pyarrow.types.is_floating(field.type)
    ]
    units = {
        name: (schema.field(name).metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
        for name in names
    }
    signals = [
        SignalInfo(number, split_unit(name)[0], units[name] or split_unit(name)[1], samples=rows)
        for number, name in enumerate(names)
    ]

    def load(keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
        with parquet.ParquetFile(path) as opened:
            table = opened.read(columns=names)
        arrays = {
            name: np.asarray(table[name].to_numpy(), dtype=np.float64)
            for name in table.column_names
        }
        return named_columns(arrays, keys, path)

    return SignalFile(path, tuple(signals), load)


def write(path: Path, table: SignalTable) -> list[str]:
    """Write a file with a column of times; missing samples are null."""
    notes: list[str] = []
    grid = table.at_one_rate(notes)
    fields = [pyarrow.field(TIME, pyarrow.float64(), metadata={"unit": "s"})]
    arrays = [pyarrow.array(np.arange(len(grid)) / table.rate_hz)]
    for signal, values in zip(table.signals, grid.T, strict=True):
        fields.append(pyarrow.field(signal.name, pyarrow.float64(), metadata={"unit": signal.unit}))
        arrays.append(pyarrow.array(values, mask=np.isnan(values)))
    schema = pyarrow.schema(fields, metadata=dict(table.metadata))
    parquet.write_table(pyarrow.table(arrays, schema=schema), path, compression="zstd")
    return notes
