"""Export of a recording as tables in CSV or Parquet, or as a repaired MCAP file.

The table of beats is computed from the recorded frames (`recorded_beats.py`); each other table has
the messages of one topic.
"""

import csv
import json
from base64 import b64decode
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from protocol.config.quantities import count_text
from protocol.errors import OutputError, SourceError
from protocol.host.output import write_whole
from protocol.wire.messages import decode_frame
from telepulse.recording.mcap_writer import McapWriter
from telepulse.recording.reader import RecordingReader
from telepulse.recording.recorded_beats import RecordedBeats
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import (
    CLOCK,
    EVENT,
    FRAME,
    NUMBER,
    SCHEMAS,
    STRING,
    TICK,
    Schema,
)

BEATS = "beats"
TABLES = {FRAME: "samples", TICK: "ticks", CLOCK: "clock", EVENT: "events", BEATS: "beats"}
# Columns of each table and their descriptions. The table of samples also has one for each channel.
COLUMNS = {
    FRAME: {
        "arrived_ns": "when its frame arrived, on the display's clock",
        "path": "data connection over which the frame arrived",
        "session": "session of the sensing node",
        "sample": "samples of the session before this one",
        "t_ns": "when it was taken, on the sensing clock",
    },
    TICK: {
        "now_ns": "when the tick was due, on the display's clock",
        "instant_ns": "instant of the pulse that was played, on the sensing clock",
        "target_n": "target force at the finger",
        "felt_n": "force felt at the finger; none where it is unknown",
        "scored": "the pulse was played at full strength",
        "predictor_error_n": "RMSE that the predictor expects; none without an estimate",
        "trusted": "the predictor was trusted with the whole delay",
        "press_n": "static force of the finger; none where it does not press back",
        "hold_down_n": "static force of the probe on the wrist, as last reported; none without",
    },
    CLOCK: {
        "session": "session of the sensing node",
        "t1_ns": "when the request left, on the display's clock",
        "t2_ns": "when the request arrived, on the sensing clock",
        "t3_ns": "when the reply left, on the sensing clock",
        "t4_ns": "when the reply arrived, on the display's clock",
        "offset_ms": "sensing clock minus display's, of this exchange alone",
        "round_trip_ms": "time on the network, there and back",
    },
    EVENT: {
        "t_ns": "Unix time",
        "level": "2 information, 3 warning, 4 error",
        "name": "kind of event",
        "message": "the event in words",
    },
    BEATS: {
        "contactor": "name of the contactor that played the beat; empty in older recordings",
        "channel": "number of its channel",
        "session": "session of the sensing node",
        "onset_ns": "where the steepest rise's tangent meets the foot, on the sensing clock",
        "peak_ns": "systolic peak, on the sensing clock",
        "notch_ns": "dicrotic notch, on the sensing clock; none without one",
        "foot_n": "force at the foot",
        "height_n": "force from foot to peak",
        "upstroke_ms": "from onset to peak",
        "interval_ms": "to the next onset",
        "rate_per_min": "heart rate by this interval",
        "quality": "0 to 1: similarity to the good beats before; none for the first three",
    },
}
NUMBERS = ("foot_n", "height_n", "upstroke_ms", "interval_ms", "rate_per_min", "quality")
BEAT_KINDS = {"contactor": STRING} | dict.fromkeys(NUMBERS, NUMBER)
UNIX = "Unix time of message, tick or onset by the display's clock; comparable across all tables"
UNITS = {"_ns": "ns", "_n": "N", "_ms": "ms", "_mv": "mV", "_per_min": "1/min"}
# Columns of a tick that each further contactor has too.
OF_EACH_CONTACTOR = ("target_n", "felt_n")
Row = list[Any]


class TableColumn(NamedTuple):
    """A column; kind: a type of JSON schema, or float32."""

    name: str
    kind: str
    description: str

    @property
    def unit(self) -> str:
        """The unit, from the suffix of the name; empty without one."""
        return next((unit for end, unit in UNITS.items() if self.name.endswith(end)), "")


UNIX_COLUMN = TableColumn("unix_ns", "integer", UNIX)


def columns(first: Entry, units: Sequence[str] = ()) -> list[TableColumn]:
    """Return the columns of a table of messages from the first one.

    units: of the stream's channels, where they are known; those of others are N. Raises KeyError
    or ValueError.
    """
    topic, fields = first.topic, first.fields
    found = _fixed_columns(topic, SCHEMAS[topic][1]["properties"])
    if topic == FRAME:
        values = decode_frame(b64decode(fields["data"])).values
        kind = "float32" if values.itemsize == 4 else "number"
        for n in range(values.shape[1]):
            if n < len(units) and units[n] == "mV":
                found.append(TableColumn(f"ecg_{n}_mv", kind, f"ECG, channel {n}"))
            else:
                found.append(TableColumn(f"force_{n}_n", kind, f"force at the wrist, channel {n}"))
    if topic == TICK:
        for n in range(1, len(fields.get("others", [])) + 1):
            for force in OF_EACH_CONTACTOR:
                text = f"{COLUMNS[topic][force]}; of contactor {n}"
                found.append(TableColumn(force.replace("_n", f"_{n}_n"), "number", text))
    return [*found, UNIX_COLUMN]


def _fixed_columns(topic: str, properties: Schema) -> list[TableColumn]:
    return [
        TableColumn(name, properties.get(name, {}).get("type", "integer"), text)
        for name, text in COLUMNS[topic].items()
    ]


def _beat_columns() -> list[TableColumn]:
    return [*_fixed_columns(BEATS, BEAT_KINDS), UNIX_COLUMN]


def rows(message: Entry) -> Iterator[Row]:
    """Yield a message's rows, None without a value. Raises KeyError, ValueError, TypeError."""
    fields = message.fields
    if message.topic == FRAME:
        frame = decode_frame(b64decode(fields["data"]))
        head = [fields["arrived_ns"], fields["path"], frame.session]
        for at, values in enumerate(frame.values.tolist()):
            t_ns = frame.t_first_ns + at * frame.period_ns
            yield [*head, frame.first_sample + at, t_ns, *values, message.t_ns]
    elif message.topic == EVENT:
        words = (fields[name] for name in ("level", "name", "message"))
        yield [message.t_ns, *words, message.t_ns]
    else:
        others = fields.get("others", []) if message.topic == TICK else []
        more = [each.get(force) for each in others for force in OF_EACH_CONTACTOR]
        yield [*(fields.get(name) for name in COLUMNS[message.topic]), *more, message.t_ns]


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
    return _export_tables(path, folder, CsvTable)


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
    return _export_tables(path, folder, ParquetTable)


def _export_tables(path: Path, folder: Path, kind: type[CsvTable] | type[ParquetTable]) -> str:
    reader, beats = RecordingReader(path), RecordedBeats()
    tables: dict[str, CsvTable | ParquetTable] = {}
    counts: Counter[str] = Counter()
    try:
        with ExitStack() as stack:

            def add(name: str, header: Callable[[], list[TableColumn]], new: Iterable[Row]) -> None:
                for row in new:
                    if name not in tables:
                        if not tables:
                            folder.mkdir(parents=True)
                        tables[name] = kind(folder / (TABLES[name] + kind.suffix), header())
                        stack.callback(tables[name].close)
                    tables[name].add(row)
                    counts[name] += 1

            for message in reader:
                if message.topic not in SCHEMAS:
                    continue
                entry = Entry(message.topic, message.t_ns, message.fields)
                found = list(beats.take(entry))
                if entry.topic in TABLES:
                    add(entry.topic, partial(columns, entry, beats.units), rows(entry))
                add(BEATS, _beat_columns, found)
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
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    reader.log_gaps()
    return f"{folder}: " + ", ".join(f"{counts[topic]} {name}" for topic, name in TABLES.items())


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
