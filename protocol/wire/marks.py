"""Marks: texts that state what happened at an instant of a display's run.

A reader of a display's telemetry requests a mark over its own connection. The display numbers it
and publishes it under the topic "mark", so that page, terminal, recorder and LSL outlet have the
same ones. No mark goes to the sensing node.
"""

from typing import NamedTuple

import msgpack

from protocol.errors import WireError
from protocol.wire.messages import TIME_RANGE
from protocol.wire.telemetry import unpack

MARK = b"mark"
# First byte of a request. ZeroMQ's own messages on this connection begin with 0 or 1.
REQUEST = b"\2"
# With four bytes a character, a request is below the 1 024 bytes that the display's socket accepts.
MOST_CHARACTERS = 200


class MarkRequest(NamedTuple):
    """Request of a reader to publish a mark.

    id: random number, by which the reader finds its own mark. at_ns: marked instant on the
    display's clock; None for the time of arrival. text: empty for a numbered mark.
    """

    id: int
    at_ns: int | None
    text: str


class Mark(NamedTuple):
    """A published mark.

    number: of the display's run, from 1 on. id: of its request. at_ns: marked instant on the
    display's clock.
    """

    number: int
    id: int
    at_ns: int
    text: str


def printable(text: str, most: int = MOST_CHARACTERS) -> str:
    """Return a text in one line, without what could control a terminal; a longer one ends in …."""
    line = "".join(each if each.isprintable() else " " for each in text).strip()
    return line if len(line) <= most else f"{line[: most - 1]}…"


def pack_request(request: MarkRequest) -> bytes:
    """Encode a request, whose text is cut to `MOST_CHARACTERS`."""
    return REQUEST + bytes(msgpack.packb(request._replace(text=printable(request.text))))


def read_request(data: bytes) -> MarkRequest:
    """Decode a request, which begins with `REQUEST`. Raises WireError."""
    try:
        request = MarkRequest(*unpack(data.removeprefix(REQUEST)))
    except (ValueError, TypeError) as error:
        raise WireError("malformed", f"not a request for a mark: {error}") from None
    at_ns = 0 if request.at_ns is None else request.at_ns
    _check(request.text, request.id, at_ns)
    return request


def pack_mark(mark: Mark) -> bytes:
    """Encode a mark."""
    return bytes(msgpack.packb(mark))


def read_mark(data: bytes) -> Mark:
    """Decode a mark. Raises WireError."""
    try:
        mark = Mark(*unpack(data))
    except (ValueError, TypeError) as error:
        raise WireError("malformed", f"not a mark: {error}") from None
    _check(mark.text, mark.number, mark.id, mark.at_ns)
    return mark


def _check(text: object, *numbers: object) -> None:
    if type(text) is not str or len(text) > MOST_CHARACTERS or text != printable(text):
        raise WireError("malformed", "a mark's text is none, too long or not printable")
    if not all(type(number) is int and number in TIME_RANGE for number in numbers):
        raise WireError("malformed", "a mark's number is out of range")
