"""Frames of samples, from a sensing node."""

import numpy as np

from fuzz.refusals import refusals
from protocol.wire.messages import Frame, decode_frame, encode_frame

MSGPACK = True


def seeds() -> list[bytes]:
    """Return one frame of each sample format."""
    values = np.array([[0.5, 0.25], [-1.25, 0.125]])
    frames = [Frame(7, 1000, 1 << 60, 1_000_000, values.astype(f)) for f in ("<f4", "<f8")]
    return [encode_frame(frame) for frame in frames]


def try_one(data: bytes) -> None:
    """Decode a frame; if accepted it is finite and survives its own encoding."""
    with refusals():
        frame = decode_frame(data)
        assert np.isfinite(frame.values).all()
        again = decode_frame(encode_frame(frame))
        assert again[:4] == frame[:4]
        assert np.array_equal(again.values, frame.values)
