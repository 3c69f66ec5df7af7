"""Tables of a recording: columns and rows of each topic, the same for every kind of file. Pure."""

from base64 import b64decode
from collections.abc import Iterator
from typing import Any, NamedTuple

from protocol.wire.messages import decode_frame
from telepulse.recording.reader import RecordedMessage
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, SCHEMAS, TICK

Row = list[Any]
TABLES = {FRAME: "samples", TICK: "ticks", CLOCK: "clock", EVENT: "events"}
UNITS = {"_ns": "ns", "_n": "N", "_ms": "ms"}
_SAMPLE = ("arrived_ns", "path", "session", "sample", "t_ns")
UNIX = "unix_ns"
_UNIX_DESCRIPTION = (
    "Unix time at which the display received or did it, by its own clock: the same in all tables"
)
_EVENT = ("level", "name", "message")
_DESCRIPTIONS = {
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
        "target_n": "force wanted at the finger",
        "felt_n": "force felt at the finger; none where it is unknown",
        "scored": "the pulse was played at its full strength",
        "predictor_error_n": "RMSE that the predictor expects; none where it expects none",
        "trusted": "the predictor was trusted with all of the delay",
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
}


class TableColumn(NamedTuple):
    """A column; kind: a type of JSON schema, or float32; unit: empty without one."""

    name: str
    kind: str
    unit: str
    description: str


def columns(message: RecordedMessage) -> list[TableColumn]:
    """Return the columns of a table, by its first message. Raises KeyError or ValueError."""
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
    """Yield a message's rows, None without a value. Raises KeyError, ValueError, TypeError."""
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
    return TableColumn(UNIX, "integer", "ns", _UNIX_DESCRIPTION)


def _column(topic: str, name: str, kind: str) -> TableColumn:
    unit = next((UNITS[end] for end in UNITS if name.endswith(end)), "")
    return TableColumn(name, kind, unit, _DESCRIPTIONS[topic].get(name, ""))
