"""Frames of samples, from a sensing node."""

import numpy as np

from fuzz.refusals import refusals
from protocol.wire.messages import decode_frame, encode_frame
from tests.support.message_examples import FLOAT32_BYTES, FLOAT64_BYTES

MSGPACK = True


def seeds() -> list[bytes]:
    """Return one frame of each sample format."""
    return [FLOAT32_BYTES, FLOAT64_BYTES]


def try_one(data: bytes) -> None:
    """Decode a frame; if accepted it is finite and survives its own encoding."""
    with refusals():
        frame = decode_frame(data)
        assert np.isfinite(frame.values).all()
        again = decode_frame(encode_frame(frame))
        assert again[:4] == frame[:4]
        assert np.array_equal(again.values, frame.values)
