"""Tables of an exported recording: their columns, and the rows of each message."""

from base64 import b64decode
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from protocol.wire.messages import decode_frame
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
        "contactor": "name of the contactor that played the beat; empty for an only one",
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


def beat_columns() -> list[TableColumn]:
    """Return the columns of the table of beats."""
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
