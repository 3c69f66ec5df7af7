"""Tables of an exported recording: their columns, the rows of each message, and the beats."""

from base64 import b64decode
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from display_node.scoring.beats import BeatAnalysis
from protocol.wire.messages import decode_frame
from telepulse.telemetry.decoder import Entry, Fields, PassiveReceiver
from telepulse.telemetry.schema import (
    CLOCK,
    EVENT,
    FRAME,
    NUMBER,
    SCHEMAS,
    STATUS,
    STRING,
    TICK,
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


def columns(first: Entry, units: Sequence[str] = ()) -> list[TableColumn]:
    """Return the columns of a table from its first entry.

    units: of the stream's channels, where they are known; those of others are N. Raises KeyError
    or ValueError.
    """
    topic, fields = first.topic, first.fields
    kinds = BEAT_KINDS if topic == BEATS else SCHEMAS[topic][1]["properties"]
    found = [
        TableColumn(name, kinds.get(name, {}).get("type", "integer"), text)
        for name, text in COLUMNS[topic].items()
    ]
    if topic == FRAME:
        values = decode_frame(b64decode(fields["data"])).values
        kind = "float32" if values.itemsize == 4 else "number"
        for n in range(values.shape[1]):
            if n < len(units) and units[n] == "mV":
                found.append(TableColumn(f"ecg_{n}_mv", kind, f"ECG, channel {n}"))
            else:
                found.append(TableColumn(f"force_{n}_n", kind, f"force at the wrist, channel {n}"))
    for n in range(1, len(_others(first)) + 1):
        for force in OF_EACH_CONTACTOR:
            text = f"{COLUMNS[topic][force]}; of contactor {n}"
            found.append(TableColumn(force.replace("_n", f"_{n}_n"), "number", text))
    return [*found, TableColumn("unix_ns", "integer", UNIX)]


def rows(entry: Entry) -> Iterator[Row]:
    """Yield an entry's rows, None without a value. Raises KeyError, ValueError, TypeError."""
    topic, unix_ns, fields = entry
    if topic == FRAME:
        frame = decode_frame(b64decode(fields["data"]))
        head = [fields["arrived_ns"], fields["path"], frame.session]
        for at, values in enumerate(frame.values.tolist()):
            t_ns = frame.t_first_ns + at * frame.period_ns
            yield [*head, frame.first_sample + at, t_ns, *values, unix_ns]
    else:
        more = [each.get(force) for each in _others(entry) for force in OF_EACH_CONTACTOR]
        known = fields | {"t_ns": unix_ns}
        yield [*(known.get(name) for name in COLUMNS[topic]), *more, unix_ns]


def _others(entry: Entry) -> list[Fields]:
    """Return the further contactors of a tick."""
    others: list[Fields] = entry.fields.get("others", []) if entry.topic == TICK else []
    return others


class RecordedBeats:
    """Analysis of the played channels of a recording, as the display finds their beats.

    A beat's times are on the sensing clock; its entry has the Unix time of its onset. Until a
    status has named the contactors, the first channel is played by one without a name.
    """

    def __init__(self) -> None:
        self._entries = PassiveReceiver()
        self._session: int | None = None
        self._instant_ns: int | None = None
        # Every force is analysed: the first status comes after the first frames.
        self._analyses: defaultdict[int, BeatAnalysis] = defaultdict(BeatAnalysis)
        self._contactors: list[tuple[str, int]] = [("", 0)]

    @property
    def units(self) -> list[str]:
        """Units of the stream's channels; none before its description."""
        description = self._entries.receiver.description
        return [] if description is None else [channel.unit for channel in description.channels]

    def take(self, entry: Entry) -> Iterator[Entry]:
        """Yield the beats that an entry completes, each as an entry of the table.

        Raises KeyError, ValueError or TypeError for fields that are not those of an entry.
        """
        fields = entry.fields
        if entry.topic == TICK:
            self._instant_ns = fields["instant_ns"]
        elif entry.topic == STATUS:
            # The buffer is emptied this often: each tick would double the time of an export.
            if self._instant_ns is not None:
                self._entries.play(self._instant_ns)
            if playing := fields.get("playing"):
                self._contactors = [(str(p["contactor"]), int(p["channel"])) for p in playing]
        elif (frame := self._entries.take(entry.topic, fields)) is not None:
            receiver = self._entries.receiver
            if frame.session != self._session:
                self._session = frame.session
                self._analyses.clear()
            unix_ahead_ns = entry.t_ns - receiver.clock.remote_ns(fields["arrived_ns"])
            found = {
                channel: self._analyses[channel].observe(frame.samples_of(channel))
                for channel, unit in enumerate(self.units)
                if unit == "N"
            }
            for name, channel in self._contactors:
                source = {"contactor": name, "channel": channel, "session": frame.session}
                for beat in found.get(channel, ()):
                    times = {
                        "upstroke_ms": beat.upstroke_s * 1e3,
                        "interval_ms": beat.interval_s * 1e3,
                        "rate_per_min": 60 / beat.interval_s,
                    }
                    beat_fields = source | beat._asdict() | times
                    yield Entry(BEATS, beat.onset_ns + unix_ahead_ns, beat_fields)
