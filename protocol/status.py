"""A status: what a node tells now and then of itself, for another process to show.

A multipart message ["status", msgpack]. A last status has final = true.
"""

from typing import Any, NamedTuple

import msgpack
from pydantic import TypeAdapter, ValidationError

from protocol.errors import WireError
from protocol.summary import Summary

STATUS = b"status"
MAX_ITEMS = 256
_SUMMARY = TypeAdapter(Summary)


class Status(NamedTuple):
    """Where a node stands: a word, its stream, its running summary.

    session: of the stream; None while there is none. displays: how many listen to a sensing node;
    None where the question does not apply.
    """

    state: str
    stream: str
    summary: dict[str, Any]
    final: bool
    session: int | None = None
    displays: int | None = None


def pack_status(
    state: str,
    stream: str,
    summary: Summary,
    final: bool,
    session: int | None = None,
    displays: int | None = None,
) -> bytes:
    """A status message, of the fields of `Status`."""
    fields = [state, stream, summary.to_dict(), final, session, displays]
    return bytes(msgpack.packb(fields))


def read_status(data: bytes) -> Status:
    """The status in a message, with every key of a summary. Raises WireError."""
    try:
        # A node of an earlier version tells the first four.
        state, stream, summary, final, *more = unpack(data)
        session, displays = more if more else (None, None)
    except (ValueError, TypeError) as error:
        raise WireError("malformed", f"not a status: {error}") from None
    if not (type(state) is type(stream) is str and type(summary) is dict and type(final) is bool):
        raise WireError("malformed", "a status' field has the wrong type")
    if not all(number is None or type(number) is int for number in (session, displays)):
        raise WireError("malformed", "a status' field has the wrong type")
    try:
        whole = _SUMMARY.validate_python(summary).to_dict()
    except ValidationError as error:
        raise WireError("malformed", f"a status' summary: {error}") from None
    return Status(state, stream, whole, final, session, displays)


def unpack(data: bytes, max_items: int = MAX_ITEMS) -> Any:
    """The msgpack in a message. Raises ValueError or TypeError.

    Room is made for what an array or a table promises; more than `max_items` are not believed.
    """
    return msgpack.unpackb(data, max_array_len=max_items, max_map_len=max_items)
