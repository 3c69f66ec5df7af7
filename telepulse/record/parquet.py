"""A table as a Parquet file: typed columns, with units and descriptions beside them."""

import json
from pathlib import Path
from typing import Any

from protocol.errors import OutputError
from telepulse.record.tables import Column, Row

ROWS_A_GROUP = 50_000
MISSING = "needs pyarrow, which cannot be loaded ({}); pip install 'telepulse[analysis]'"


class ParquetTable:
    """Rows go in, in any number; what is in memory stays bounded."""

    suffix = ".parquet"

    def __init__(self, path: Path, columns: list[Column]) -> None:
        """Raises OSError; OutputError without pyarrow."""
        check_parquet()
        import pyarrow
        from pyarrow import parquet

        kinds = {
            "integer": pyarrow.int64(),
            "number": pyarrow.float64(),
            "float32": pyarrow.float32(),
            "boolean": pyarrow.bool_(),
            "string": pyarrow.string(),
        }
        self._pyarrow: Any = pyarrow
        self._schema = pyarrow.schema(
            [
                pyarrow.field(
                    column.name,
                    kinds[column.kind],
                    metadata={"unit": column.unit, "description": column.says},
                )
                for column in columns
            ],
            metadata={"creator": "telepulse"},
        )
        self._writer = parquet.ParquetWriter(path, self._schema, compression="zstd")
        self._rows: list[Row] = []

    def add(self, row: Row) -> None:
        """Take a row. Raises OSError; ValueError for one of another width."""
        if len(row) != len(self._schema):
            raise ValueError(f"{len(row)} values in a table of {len(self._schema)} columns")
        self._rows.append(row)
        if len(self._rows) >= ROWS_A_GROUP:
            self._flush()

    def describe(self, described: dict[str, Any]) -> None:
        """Add what produced the recording to the file's metadata, each key as JSON."""
        texts = {f"telepulse.{key}": json.dumps(value) for key, value in described.items()}
        self._writer.add_key_value_metadata(texts)

    def close(self) -> None:
        """Write what is left, and the end. Raises OSError."""
        try:
            self._flush()
        finally:
            self._writer.close()

    def _flush(self) -> None:
        if not self._rows:
            return
        arrays = [
            self._pyarrow.array(values, field.type)
            for values, field in zip(zip(*self._rows, strict=True), self._schema, strict=True)
        ]
        self._rows.clear()
        self._writer.write_batch(self._pyarrow.record_batch(arrays, schema=self._schema))


def check_parquet() -> None:
    """Say before the work that pyarrow is missing. Raises OutputError."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise OutputError(f"an export to parquet {MISSING.format(error)}") from None
