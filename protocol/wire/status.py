"""Status of a node, published some times a second for other processes to show.

A multipart message ["status", msgpack]. A last status has final = true.
"""

from typing import Annotated, Any, NamedTuple

import msgpack
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from protocol.errors import WireError
from protocol.run_summary import LARGEST, Summary
from protocol.wire.messages import COUNT_RANGE, MAX_CHANNELS, TIME_RANGE

STATUS = b"status"
MAX_ITEMS = 256
_SUMMARY = TypeAdapter(Summary)


class PlaybackStatus(NamedTuple):
    """How a display plays the stream.

    Attributes
    ----------
    channel : int
        Channel that it plays.
    force_ratio : float
        Force at the finger per force at the wrist that makes both strains equal.
    strain_per_newton : float
        Strain of the layer under the finger, in 1/N.
    predictor : str
        Name of the predictor.
    stale_after_ns : int
        Time without samples after which the stream is stale.
    """

    channel: Annotated[int, Field(ge=0, lt=MAX_CHANNELS)]
    force_ratio: Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
    strain_per_newton: Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
    predictor: str
    stale_after_ns: Annotated[int, Field(ge=0, lt=TIME_RANGE.stop)]


class Status(NamedTuple):
    """Status of a node: a state, its stream, its running summary.

    Attributes
    ----------
    session : int or None
        Session of the stream; None while there is none.
    displays : int or None
        Displays connected to a sensing node; None for a display.
    playing : PlaybackStatus or None
        Of a display that has the stream's description.
    """

    state: str
    stream: str
    summary: dict[str, Any]
    final: bool
    session: int | None = None
    displays: int | None = None
    playing: PlaybackStatus | None = None


_PLAYING = TypeAdapter(PlaybackStatus, config=ConfigDict(strict=True, allow_inf_nan=False))


def pack_status(
    state: str,
    stream: str,
    summary: Summary,
    final: bool,
    session: int | None = None,
    displays: int | None = None,
    playing: PlaybackStatus | None = None,
) -> bytes:
    """Encode a status message, from the fields of `Status`."""
    fields = [state, stream, summary.to_dict(), final, session, displays, playing]
    return bytes(msgpack.packb(fields))


def read_status(data: bytes) -> Status:
    """Decode a status, with every key of a summary. Raises WireError."""
    try:
        state, stream, summary, final, session, displays, playing = unpack(data)
        if playing is not None:
            playing = _PLAYING.validate_python(PlaybackStatus(*playing))
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
    if not _countable(whole):
        raise WireError("malformed", "a count of a status' summary is out of range")
    return Status(state, stream, whole, final, session, displays, playing)


def _countable(value: Any) -> bool:
    """Check that every whole number in a summary is one that a float holds exactly."""
    if isinstance(value, dict):
        return all(_countable(inner) for inner in value.values())
    return not isinstance(value, int) or abs(value) in COUNT_RANGE


def unpack(data: bytes, max_items: int = MAX_ITEMS) -> Any:
    """Decode msgpack with at most `max_items` in a container. Raises ValueError or TypeError.

    msgpack allocates as many items as a container's header announces.
    """
    return msgpack.unpackb(data, max_array_len=max_items, max_map_len=max_items)
