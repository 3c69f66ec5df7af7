"""Export of a recording as tables in CSV or Parquet, or as a whole MCAP file again."""

import csv
import json
import logging
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Any

from protocol.config.quantities import count_text
from protocol.errors import OutputError, SourceError
from protocol.host.result_files import write_whole
from telepulse.recording.mcap_writer import McapWriter
from telepulse.recording.reader import RecordedMessage, RecordingReader
from telepulse.recording.tables import (
    TABLES,
    Row,
    TableColumn,
    columns,
    rows,
)
from telepulse.telemetry.schema import SCHEMAS

logger = logging.getLogger(__name__)

MESSAGES_A_CHUNK = 5_000
PROVENANCE = "provenance.json"


class CsvTable:
    """Writer of a table as CSV: numbers in full, empty without a value."""

    suffix = ".csv"

    def __init__(self, path: Path, columns: list[TableColumn]) -> None:
        """Create the file. Raises OSError."""
        self._file = path.open("w", newline="", encoding="utf-8")
        writer = csv.writer(self._file)
        writer.writerow([column.name for column in columns])
        self.add: Callable[[Row], object] = writer.writerow
        self.close = self._file.close


ROWS_A_GROUP = 50_000
MISSING = "needs pyarrow, which cannot be loaded ({}); pip install 'telepulse[analysis]'"


class ParquetTable:
    """Writer of a table as Parquet, with units and descriptions; its memory is bounded."""

    suffix = ".parquet"

    def __init__(self, path: Path, columns: list[TableColumn]) -> None:
        """Create the file. Raises OSError; OutputError without pyarrow."""
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
    """Raise OutputError where pyarrow is missing, before any work."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise OutputError(f"an export to parquet {MISSING.format(error)}") from None


TableWriter = type[CsvTable] | type[ParquetTable]


def export_csv(path: Path, folder: Path) -> str:
    """Write a recording's tables into a new folder; return how many rows, in a line.

    Raises SourceError or OutputError.
    """
    return _export_tables(path, folder, CsvTable)


def export_parquet(path: Path, folder: Path) -> str:
    """Write a recording's tables with typed columns into a new folder.

    Raises SourceError or OutputError, the latter also without pyarrow.
    """
    check_parquet()
    return _export_tables(path, folder, ParquetTable)


def _export_tables(path: Path, folder: Path, kind: TableWriter) -> str:
    reader, tables = RecordingReader(path), _Tables(folder, kind)
    try:
        with tables:
            for message in reader:
                if message.topic in TABLES:
                    tables.add(message)
            tables.describe(path, reader)
    except FileExistsError:
        raise OutputError(f"{folder}: is there already; name another by --out") from None
    except (SourceError, OutputError):
        raise
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    except (LookupError, ValueError, TypeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    _log_gaps(path, reader)
    return f"{folder}: " + ", ".join(f"{tables.rows[t]} {name}" for t, name in TABLES.items())


class _Tables(ExitStack):
    """Files of a folder, one a topic, created for the first message; rows: count in each."""

    def __init__(self, folder: Path, kind: TableWriter) -> None:
        super().__init__()
        self._folder = folder
        self._kind = kind
        self._files: dict[str, CsvTable | ParquetTable] = {}
        self._columns: dict[str, list[TableColumn]] = {}
        self.rows: Counter[str] = Counter()

    def add(self, message: RecordedMessage) -> None:
        """Write a message's rows. Raises OSError; LookupError, ValueError, TypeError for fields."""
        if message.topic not in self._files:
            self._files[message.topic] = self._open(message)
        file = self._files[message.topic]
        for row in rows(message):
            file.add(row)
            self.rows[message.topic] += 1

    def describe(self, path: Path, reader: RecordingReader) -> None:
        """Write provenance, gaps and the columns' descriptions beside the tables.

        Raises OutputError.
        """
        if not self._files:
            return
        described = {
            "recording": str(path),
            "whole": reader.whole,
            "gaps": reader.gaps(),
            "runs": [dict(run) for run in reader.provenance],
            "columns": {
                name: {c.name: {"unit": c.unit, "description": c.description} for c in found}
                for name, found in self._columns.items()
            },
        }
        for file in self._files.values():
            if isinstance(file, ParquetTable):
                file.describe(described)
        write_whole(self._folder / PROVENANCE, json.dumps(described, indent=2) + "\n")

    def _open(self, first: RecordedMessage) -> CsvTable | ParquetTable:
        if not self._files:
            self._folder.mkdir(parents=True)
        path = self._folder / f"{TABLES[first.topic]}{self._kind.suffix}"
        self._columns[path.name] = columns(first)
        file = self._kind(path, self._columns[path.name])
        self.callback(file.close)
        return file


def export_mcap(path: Path, copy: Path) -> str:
    """Write what can be read of a recording as a whole one. Raises SourceError or OutputError."""
    reader = RecordingReader(path)
    messages = (message for message in reader if message.topic in SCHEMAS)
    # What cannot be read leaves no file behind.
    first = next(messages, None)
    if first is None:
        raise SourceError(f"{path}: holds no message")
    writer = McapWriter(copy)
    for number, message in enumerate(chain([first], messages)):
        writer.put(*message)
        if number % MESSAGES_A_CHUNK == 0:
            writer.flush()
    for provenance in reader.provenance:
        writer.describe(provenance)
    reason = writer.close()
    if reason is not None or writer.dropped:
        raise OutputError(f"{copy}: cannot be written: {reason or 'the disk was full'}")
    _log_gaps(path, reader)
    return f"{copy}: {count_text(sum(writer.written.values()), 'message')}"


def _log_gaps(path: Path, reader: RecordingReader) -> None:
    """Log what of a recording could not be read."""
    for line in reader.gaps():
        logger.warning(f"{path}: {line}")
