"""Export of a recording as tables in CSV or Parquet, or as a repaired MCAP file.

The table of beats is computed from the recorded frames (`RecordedBeats`); each other table has
the messages of one topic.
"""

import csv
import json
from collections import Counter
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Any

from protocol.config.quantities import count_text
from protocol.errors import OutputError, SourceError
from protocol.host.output import write_whole
from telepulse.recording.export_tables import TABLES, RecordedBeats, Row, TableColumn, columns, rows
from telepulse.recording.mcap_reader import RecordingReader, reading
from telepulse.recording.mcap_writer import McapWriter
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import SCHEMAS


class CsvTable:
    """Writer of a table as CSV: numbers in full, empty without a value."""

    suffix = ".csv"

    def __init__(self, path: Path, columns: list[TableColumn]) -> None:
        """Create the file. Raises OSError."""
        self.name, self.columns = path.name, columns
        self._file = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        self.add([column.name for column in columns])

    def add(self, row: Row) -> None:
        """Write a row. Raises OSError."""
        self._writer.writerow(row)

    def describe(self, described: dict[str, Any]) -> None:
        """Do nothing: CSV has no metadata."""

    def close(self) -> None:
        """Close the file. Raises OSError."""
        self._file.close()


ROWS_A_GROUP = 50_000


class ParquetTable:
    """Writer of a table as Parquet, with units and descriptions; its memory is bounded."""

    suffix = ".parquet"

    def __init__(self, path: Path, columns: list[TableColumn]) -> None:
        """Create the file. Raises OSError."""
        import pyarrow
        from pyarrow import parquet

        self.name, self.columns = path.name, columns
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
                    metadata={"unit": column.unit, "description": column.description},
                )
                for column in columns
            ],
            metadata={"creator": "telepulse"},
        )
        self._writer = parquet.ParquetWriter(path, self._schema, compression="zstd")
        self._rows: list[Row] = []

    def add(self, row: Row) -> None:
        """Add a row. Raises OSError; ValueError for one of another width."""
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
        """Write the remaining rows and the end. Raises OSError."""
        try:
            if self._rows:
                self._flush()
        finally:
            self._writer.close()

    def _flush(self) -> None:
        arrays = [
            self._pyarrow.array(values, field.type)
            for values, field in zip(zip(*self._rows, strict=True), self._schema, strict=True)
        ]
        self._rows.clear()
        self._writer.write_batch(self._pyarrow.record_batch(arrays, schema=self._schema))


def export_csv(path: Path, folder: Path) -> str:
    """Write a recording's tables into a new folder; return the numbers of rows, as text.

    Raises SourceError or OutputError.
    """
    return _write_tables(path, folder, CsvTable)


def export_parquet(path: Path, folder: Path) -> str:
    """Write a recording's tables with typed columns into a new folder.

    Raises SourceError or OutputError, the latter also without pyarrow.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise OutputError(
            f"an export to parquet needs pyarrow, which cannot be loaded ({error});"
            " pip install 'telepulse[analysis]'"
        ) from None
    return _write_tables(path, folder, ParquetTable)


def _write_tables(path: Path, folder: Path, kind: type[CsvTable] | type[ParquetTable]) -> str:
    reader, beats = RecordingReader(path), RecordedBeats()
    tables: dict[str, CsvTable | ParquetTable] = {}
    counts: Counter[str] = Counter()
    try:
        with reading(path), ExitStack() as stack:
            for message in reader:
                if message.topic not in SCHEMAS:
                    continue
                entry = Entry(message.topic, message.t_ns, message.fields)
                for each in [entry, *beats.take(entry)]:
                    if (name := TABLES.get(each.topic)) is None:
                        continue
                    for row in rows(each):
                        if name not in tables:
                            if not tables:
                                folder.mkdir(parents=True)
                            header = columns(each, beats.units)
                            tables[name] = kind(folder / (name + kind.suffix), header)
                            stack.callback(tables[name].close)
                        tables[name].add(row)
                        counts[name] += 1
            if tables:
                described = _description(path, reader, list(tables.values()))
                for table in tables.values():
                    table.describe(described)
                write_whole(folder / "provenance.json", json.dumps(described, indent=2) + "\n")
    except FileExistsError:
        raise OutputError(f"{folder}: exists already; name another by --out") from None
    except (SourceError, OutputError):
        raise
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    reader.log_gaps()
    return f"{folder}: " + ", ".join(f"{counts[name]} {name}" for name in TABLES.values())


def _description(
    path: Path, reader: RecordingReader, tables: list[CsvTable | ParquetTable]
) -> dict[str, Any]:
    """Return provenance, gaps and the columns' descriptions, as plain types."""
    return {
        "recording": str(path),
        "whole": reader.whole,
        "gaps": reader.gaps(),
        "runs": reader.provenance,
        "about": reader.about,
        "columns": {
            table.name: {
                column.name: {"unit": column.unit, "description": column.description}
                for column in table.columns
            }
            for table in tables
        },
    }


MESSAGES_A_CHUNK = 5_000


def export_mcap(path: Path, copy: Path) -> str:
    """Write the readable part of a recording as a new one. Raises SourceError or OutputError."""
    reader = RecordingReader(path)
    messages = (message for message in reader if message.topic in SCHEMAS)
    # Read before the file is created: an unreadable recording leaves no file behind.
    first = next(messages, None)
    if first is None:
        raise SourceError(f"{path}: holds no message")
    writer = McapWriter(copy)
    for number, message in enumerate(chain([first], messages)):
        writer.put(*message)
        if number % MESSAGES_A_CHUNK == 0:
            writer.flush()
    if reader.about:
        writer.state(reader.about)
    for provenance in reader.provenance:
        writer.describe(provenance)
    reason = writer.close()
    if reason is not None or writer.dropped:
        raise OutputError(f"{copy}: cannot be written: {reason or 'the disk was full'}")
    reader.log_gaps()
    return f"{copy}: {count_text(sum(writer.written.values()), 'message')}"
