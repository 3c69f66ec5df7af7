"""Frames of a sensor board.

The first byte chooses between raw bytes of the line, and the content of a frame with a valid CRC
and COBS encoding.
"""

import math
import struct

from fuzz.packets import check_decoder
from protocol.serial_frames import decode_frame, encode_frame
from pulse_sensors.binary_frames import FrameDecoder, FrameEncoder, SampleFormat

PERIOD_NS = 1_000_000
FORMATS: tuple[SampleFormat, ...] = ("int16", "int32", "float32")
_HEAD = struct.Struct("<BII")


def seeds() -> list[bytes]:
    """Return frames of each format, raw and as contents; one with NaN."""
    lines, contents = [], []
    for sample_format in FORMATS:
        encoder = FrameEncoder(sample_format)
        frames = [encoder.frame([0, 1, -2, 3], 4000 * (n + 1)) for n in range(3)]
        lines.append(b"\x00\x00" + b"".join(frames))
        bodies = [decode_frame(frame[:-1]) for frame in frames]
        contents.append(b"\x01" + b"".join(bytes([len(body)]) + body for body in bodies))
    spoilt = FrameEncoder("float32").frame([math.nan, math.inf, 1e31], 1)
    signalling = _HEAD.pack(0x13, 0, 1) + bytes.fromhex("010080ff")
    return [*lines, *contents, b"\0\0" + spoilt, b"\1" + bytes([len(signalling)]) + signalling]


def try_one(data: bytes) -> None:
    """Decode any bytes in pieces of any size, or any contents."""
    if data:
        line = _framed(data[1:]) if data[0] & 1 else data[1:]
        check_decoder(FrameDecoder(PERIOD_NS), line, 1 + (data[0] >> 1) * 3)


def _framed(data: bytes) -> bytes:
    # A content's length is the byte before it.
    line = b"\0"
    while data:
        body, data = data[1 : 1 + data[0]], data[1 + data[0] :]
        line += encode_frame(body)
    return line
