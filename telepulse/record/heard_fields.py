"""What the display heard from its sensing node, as fields of a recording's messages."""

from base64 import b64encode
from typing import Any

from display_node.heard import CONTROL, Message
from protocol.errors import WireError
from protocol.messages import (
    Bye,
    ClockReply,
    Frame,
    Welcome,
    decode_control,
    decode_frame,
)

Fields = dict[str, Any]
Decoded = Frame | Welcome | ClockReply | Bye


def decode(message: Message) -> Decoded:
    """What a message says. Raises WireError."""
    if message.path != CONTROL:
        return decode_frame(message.data)
    control = decode_control(message.data)
    if isinstance(control, Welcome | ClockReply | Bye):
        return control
    raise WireError("unexpected", "a message that only displays send")


def frame_fields(message: Message, frame: Frame) -> Fields:
    """A frame as it came: when, over which path, its exact bytes, and its samples in N."""
    values = frame.values
    return {
        "arrived_ns": message.arrived_ns,
        "path": message.path,
        "session": frame.session,
        "first_sample": frame.first_sample,
        "t_first_ns": frame.t_first_ns,
        "period_ns": frame.period_ns,
        "channels": values.shape[1],
        "bytes_per_sample": values.itemsize,
        "force_n": values.ravel().tolist(),
        "newest_n": float(values[-1, 0]),
        "data": _text(message.data),
    }


def stream_fields(message: Message, welcome: Welcome) -> Fields:
    """The stream's description."""
    return {
        "arrived_ns": message.arrived_ns,
        "session": welcome.session,
        "samples_sent": welcome.samples_sent,
        **welcome.description.to_wire(),
        "data": _text(message.data),
    }


def clock_fields(message: Message, reply: ClockReply) -> Fields:
    """A clock exchange: t1 and t4 on the display's clock, t2 and t3 on the sensing node's."""
    t4_ns = message.arrived_ns
    ahead_ns = (reply.t2_ns - reply.t1_ns + reply.t3_ns - t4_ns) / 2
    round_trip_ns = t4_ns - reply.t1_ns - (reply.t3_ns - reply.t2_ns)
    return {
        "session": reply.session,
        "t1_ns": reply.t1_ns,
        "t2_ns": reply.t2_ns,
        "t3_ns": reply.t3_ns,
        "t4_ns": t4_ns,
        "offset_ms": ahead_ns * 1e-6,
        "round_trip_ms": round_trip_ns * 1e-6,
    }


def refused_fields(message: Message, error: WireError) -> Fields:
    """A message that is none, and why."""
    return {
        "arrived_ns": message.arrived_ns,
        "path": message.path,
        "cause": error.cause,
        "data": _text(message.data),
    }


def _text(data: bytes) -> str:
    return b64encode(data).decode("ascii")
