"""Control messages, from either node."""

from fuzz.refusals import refusals
from protocol.tactile import ElasticLayer, matching_force_ratio
from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    DisplayReport,
    Hello,
    ProbeReport,
    SetPoint,
    Welcome,
    decode_control,
    encode_control,
)
from protocol.wire.stream import Channel, StreamDescription

MSGPACK = True

DESCRIPTION = StreamDescription(
    "pulse", 1_000_000, 5, (Channel("force"), Channel("more")), ElasticLayer()
)


def seeds() -> list[bytes]:
    """Return one message of each kind."""
    messages = (
        Hello("display"),
        Welcome(7, 250, DESCRIPTION),
        Bye(7, 5000),
        ClockRequest(-5),
        ClockReply(7, 1, 2, 3),
        DisplayReport(7, "display", 90, 5, 6, 4, 1.5, 2.5, 40.0, 0.25),
        SetPoint(7, 11, 3, 600_000_000, 400_000_000, 1.5),
        ProbeReport(7, 11, 4, 2, 1, 9, "pressing", 1.5, -0.25),
    )
    return [encode_control(message) for message in messages]


def try_one(data: bytes) -> None:
    """Decode a message; if accepted it survives its own encoding, and its layer can be matched."""
    with refusals():
        message = decode_control(data)
        # NaN is not equal to itself, but its text is.
        assert repr(decode_control(encode_control(message))) == repr(message)
        if isinstance(message, Welcome):
            matching_force_ratio(message.description.layer, ElasticLayer())
