"""A recording's messages as rows of tables: the same for every kind of file. Pure.

A table as a Parquet file: typed columns, with units and descriptions beside them.
"""

import json
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from protocol.errors import OutputError
from protocol.wire.messages import decode_frame
from telepulse.recording.reader import RecordedMessage
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, SCHEMAS, TICK

Row = list[Any]
TABLES = {FRAME: "samples", TICK: "ticks", CLOCK: "clock", EVENT: "events"}
UNITS = {"_ns": "ns", "_n": "N", "_ms": "ms"}
_SAMPLE = ("arrived_ns", "path", "session", "sample", "t_ns")
UNIX = "unix_ns"
_UNIX_SAYS = (
    "Unix time at which the display received or did it, by its own clock: the same in all tables"
)
_EVENT = ("level", "name", "message")
_SAYS = {
    FRAME: {
        "arrived_ns": "when its frame came, on the display's clock",
        "path": "data connection that the frame came over",
        "session": "session of the sensing node",
        "sample": "samples of the session before this one",
        "t_ns": "when it was taken, on the sensing clock",
    },
    TICK: {
        "now_ns": "when the tick was due, on the display's clock",
        "instant_ns": "instant of the pulse that was played, on the sensing clock",
        "target_n": "force wanted at the finger",
        "felt_n": "force felt at the finger; none where it is unknown",
        "scored": "the pulse was played at its full strength",
        "predictor_error_n": "RMSE that the predictor expects of itself; none where it says none",
        "trusted": "the predictor was trusted with all of the delay",
    },
    CLOCK: {
        "session": "session of the sensing node",
        "t1_ns": "when the request left, on the display's clock",
        "t2_ns": "when the request came, on the sensing clock",
        "t3_ns": "when the reply left, on the sensing clock",
        "t4_ns": "when the reply came, on the display's clock",
        "offset_ms": "sensing clock minus display's, of this exchange alone",
        "round_trip_ms": "time on the network, there and back",
    },
    EVENT: {
        "t_ns": "Unix time",
        "level": "2 information, 3 warning, 4 error",
        "name": "what kind of thing happened",
        "message": "what happened",
    },
}


class TableColumn(NamedTuple):
    """A column: its name; kind, a JSON schema's word or float32; its unit, if it has one; what it
    says."""

    name: str
    kind: str
    unit: str
    says: str


def columns(message: RecordedMessage) -> list[TableColumn]:
    """The columns of a table, by its first message. Raises KeyError or ValueError."""
    topic = message.topic
    if topic == FRAME:
        values = decode_frame(b64decode(message.fields["data"])).values
        kind = "float32" if values.itemsize == 4 else "number"
        forces = [
            TableColumn(f"force_{n}_n", kind, "N", f"force at the wrist, channel {n}")
            for n in range(values.shape[1])
        ]
        return [*(_column(topic, name, "integer") for name in _SAMPLE), *forces, _unix()]
    properties = SCHEMAS[topic][1]["properties"]
    if topic == EVENT:
        kinds = {"t_ns": "integer", "level": "integer", "name": "string", "message": "string"}
        return [*(_column(topic, name, kind) for name, kind in kinds.items()), _unix()]
    return [
        *(_column(topic, name, schema["type"]) for name, schema in properties.items()),
        _unix(),
    ]


def rows(message: RecordedMessage) -> Iterator[Row]:
    """A message's rows; None where there is no value. Raises KeyError, ValueError, TypeError."""
    fields = message.fields
    if message.topic == FRAME:
        frame = decode_frame(b64decode(fields["data"]))
        head = [fields["arrived_ns"], fields["path"], frame.session]
        for at, values in enumerate(frame.values.tolist()):
            t_ns = frame.t_first_ns + at * frame.period_ns
            yield [*head, frame.first_sample + at, t_ns, *values, message.t_ns]
    elif message.topic == EVENT:
        yield [message.t_ns, *(fields[name] for name in _EVENT), message.t_ns]
    else:
        properties = SCHEMAS[message.topic][1]["properties"]
        yield [*(fields.get(name) for name in properties), message.t_ns]


def _unix() -> TableColumn:
    return TableColumn(UNIX, "integer", "ns", _UNIX_SAYS)


def _column(topic: str, name: str, kind: str) -> TableColumn:
    unit = next((UNITS[end] for end in UNITS if name.endswith(end)), "")
    return TableColumn(name, kind, unit, _SAYS[topic].get(name, ""))


ROWS_A_GROUP = 50_000
MISSING = "needs pyarrow, which cannot be loaded ({}); pip install 'telepulse[analysis]'"


class ParquetTable:
    """Rows go in, in any number; what is in memory stays bounded."""

    suffix = ".parquet"

    def __init__(self, path: Path, columns: list[TableColumn]) -> None:
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
