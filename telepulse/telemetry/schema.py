"""Topics of a recording and their JSON schemas.

Foxglove supports a part of JSON Schema: a type is one word, every object names its properties, an
array's items are no arrays, and nothing may be null. So a field without a value is left out.
"""

import dataclasses
import types
import typing
from typing import Any

from protocol.run_summary import Summary

Schema = dict[str, Any]
INTEGER, NUMBER, STRING, BOOLEAN = ({"type": t} for t in ("integer", "number", "string", "boolean"))
BYTES = {"type": "string", "contentEncoding": "base64"}
_PLAIN = {int: INTEGER, float: NUMBER, str: STRING, bool: BOOLEAN}
LEVELS = {"INFO": 2, "WARNING": 3, "ERROR": 4}


def _object(**properties: Schema) -> Schema:
    return {"type": "object", "properties": properties}


def _array(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _of(kind: Any) -> Schema:
    """Return the schema of a type of a summary's field."""
    if isinstance(kind, types.UnionType):
        (kind,) = [part for part in typing.get_args(kind) if part is not types.NoneType]
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return _object(**{name: _of(hint) for name, hint in hints.items()})
    if typing.get_origin(kind) is list:
        return _array(_of(*typing.get_args(kind)))
    # Counts by free names.
    return _object() if typing.get_origin(kind) is dict else _PLAIN[kind]


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
            arrived_ns=INTEGER,
            path=INTEGER,
            session=INTEGER,
            first_sample=INTEGER,
            t_first_ns=INTEGER,
            period_ns=INTEGER,
            channels=INTEGER,
            bytes_per_sample=INTEGER,
            force_n=_array(NUMBER),
            newest_n=NUMBER,
            data=BYTES,
        ),
    ),
    TICK: (
        "telepulse.Tick",
        _object(
            now_ns=INTEGER,
            instant_ns=INTEGER,
            target_n=NUMBER,
            felt_n=NUMBER,
            scored=BOOLEAN,
            predictor_error_n=NUMBER,
            trusted=BOOLEAN,
        ),
    ),
    STATUS: (
        "telepulse.Status",
        _object(
            state=STRING,
            stream=STRING,
            final=BOOLEAN,
            session=INTEGER,
            displays=INTEGER,
            playing=_object(
                channel=INTEGER,
                force_ratio=NUMBER,
                strain_per_newton=NUMBER,
                predictor=STRING,
                stale_after_ns=INTEGER,
            ),
            summary=_of(Summary),
        ),
    ),
    STREAM: (
        "telepulse.Stream",
        _object(
            arrived_ns=INTEGER,
            session=INTEGER,
            samples_sent=INTEGER,
            name=STRING,
            period_ns=INTEGER,
            batch=INTEGER,
            channels=_array(_object(name=STRING, unit=STRING)),
            layer=_object(
                young_modulus_pa=NUMBER,
                thickness_m=NUMBER,
                poisson_ratio=NUMBER,
                contact_length_m=NUMBER,
            ),
            bytes_per_sample=INTEGER,
            group_delay_ns=INTEGER,
            data=BYTES,
        ),
    ),
    CLOCK: (
        "telepulse.Clock",
        _object(
            session=INTEGER,
            t1_ns=INTEGER,
            t2_ns=INTEGER,
            t3_ns=INTEGER,
            t4_ns=INTEGER,
            offset_ms=NUMBER,
            round_trip_ms=NUMBER,
        ),
    ),
    REFUSED: (
        "telepulse.Refused",
        _object(arrived_ns=INTEGER, path=INTEGER, cause=STRING, data=BYTES),
    ),
    EVENT: (
        "foxglove.Log",
        _object(
            timestamp={**_object(sec=INTEGER, nsec=INTEGER), "title": "time"},
            level={"oneOf": [{"title": name, "const": at} for name, at in LEVELS.items()]},
            message=STRING,
            name=STRING,
            file=STRING,
            line=INTEGER,
        ),
    ),
}
