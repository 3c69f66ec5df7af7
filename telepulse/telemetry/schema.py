"""Topics of a recording and their JSON schemas.

Foxglove supports a part of JSON Schema: a type is one word, every object names its properties, an
array's items are no arrays, and nothing may be null. So a field without a value is left out.
"""

import dataclasses
import types
import typing
from enum import StrEnum
from typing import Any

from protocol.faults import Fault
from protocol.summary.fields import Summary
from protocol.wire.description import StreamDescription
from protocol.wire.telemetry import PlaybackStatus

Schema = dict[str, Any]
INTEGER, NUMBER, STRING, BOOLEAN = ({"type": t} for t in ("integer", "number", "string", "boolean"))
BYTES = {"type": "string", "contentEncoding": "base64"}
_PLAIN = {int: INTEGER, float: NUMBER, str: STRING, bool: BOOLEAN}
LEVELS = {"INFO": 2, "WARNING": 3, "ERROR": 4}


def _object(**properties: Schema) -> Schema:
    return {"type": "object", "properties": properties}


def _each(schema: Schema, *names: str) -> dict[str, Schema]:
    return dict.fromkeys(names, schema)


def _of(kind: Any) -> Schema:
    """Return the schema of a type: a table of fields, or the type of a field in one."""
    if isinstance(kind, types.UnionType):
        (kind,) = [part for part in typing.get_args(kind) if part is not types.NoneType]
    if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        hints = typing.get_type_hints(kind)
        # A fault's JSON has its remedy as well.
        derived = {"remedy": str} if kind is Fault else {}
        return _object(**{name: _of(hint) for name, hint in (hints | derived).items()})
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return STRING
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin in (list, tuple):
        return {"type": "array", "items": _of(parts[0])}
    if origin is typing.Literal:
        return _PLAIN[type(parts[0])]
    # Counts by free names.
    return _object() if origin is dict else _PLAIN[kind]


FRAME, TICK, STATUS = "/frame", "/tick", "/status"
STREAM, CLOCK, REFUSED, EVENT = "/stream", "/clock", "/refused", "/event"
TOPIC_NAMES = {
    FRAME: ("frame", "frames"),
    TICK: ("tick", "ticks"),
    STATUS: ("status", "statuses"),
    STREAM: ("description", "descriptions"),
    CLOCK: ("clock reply", "clock replies"),
    EVENT: ("event", "events"),
    REFUSED: ("message that is none", "messages that are none"),
}

SCHEMAS: dict[str, tuple[str, Schema]] = {
    FRAME: (
        "telepulse.Frame",
        _object(
            **_each(INTEGER, "arrived_ns", "path", "session", "first_sample", "t_first_ns"),
            **_each(INTEGER, "period_ns", "channels", "bytes_per_sample"),
            force_n=_of(list[float]),
            newest_n=NUMBER,
            data=BYTES,
        ),
    ),
    TICK: (
        "telepulse.Tick",
        _object(
            **_each(INTEGER, "now_ns", "instant_ns"),
            **_each(NUMBER, "target_n", "felt_n"),
            scored=BOOLEAN,
            predictor_error_n=NUMBER,
            trusted=BOOLEAN,
            **_each(NUMBER, "press_n", "hold_down_n"),
            others={
                "type": "array",
                "items": _object(**_each(NUMBER, "target_n", "felt_n", "predictor_error_n")),
            },
        ),
    ),
    STATUS: (
        "telepulse.Status",
        _object(
            **_each(STRING, "state", "stream"),
            final=BOOLEAN,
            **_each(INTEGER, "session", "displays"),
            playing=_of(list[PlaybackStatus]),
            summary=_of(Summary),
        ),
    ),
    STREAM: (
        "telepulse.Stream",
        _object(
            **_each(INTEGER, "arrived_ns", "session", "samples_sent"),
            **_of(StreamDescription)["properties"],
            data=BYTES,
        ),
    ),
    CLOCK: (
        "telepulse.Clock",
        _object(
            **_each(INTEGER, "session", "t1_ns", "t2_ns", "t3_ns", "t4_ns"),
            **_each(NUMBER, "offset_ms", "round_trip_ms"),
        ),
    ),
    REFUSED: (
        "telepulse.Refused",
        _object(**_each(INTEGER, "arrived_ns", "path"), cause=STRING, data=BYTES),
    ),
    EVENT: (
        "foxglove.Log",
        _object(
            timestamp={**_object(sec=INTEGER, nsec=INTEGER), "title": "time"},
            level={"oneOf": [{"title": name, "const": at} for name, at in LEVELS.items()]},
            **_each(STRING, "message", "name", "file"),
            line=INTEGER,
        ),
    ),
}
