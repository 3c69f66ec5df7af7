"""Control messages, from either node."""

from fuzz.refusals import refusals
from protocol.tactile import ElasticLayer, matching_force_ratio
from protocol.wire.messages import (
    Welcome,
    decode_control,
    encode_control,
)
from tests.support.message_examples import CONTROL

MSGPACK = True


def seeds() -> list[bytes]:
    """Return one message of each kind."""
    return [data for _, data in CONTROL.values()]


def try_one(data: bytes) -> None:
    """Decode a message; if accepted it survives its own encoding, and its layer can be matched."""
    with refusals():
        message = decode_control(data)
        # NaN is not equal to itself, but its text is.
        assert repr(decode_control(encode_control(message))) == repr(message)
        if isinstance(message, Welcome):
            matching_force_ratio(message.description.layer, ElasticLayer())
