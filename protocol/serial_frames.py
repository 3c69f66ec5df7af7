"""Frames on a board's serial line, as both of our boards send them. Pure.

A frame is a body and its CRC-16/CCITT-FALSE, in little-endian order, encoded by COBS and ended by a
zero byte, which occurs nowhere else.
"""

import binascii
from collections import Counter

from cobs import cobs

from protocol.errors import WireError

CRC_BYTES = 2


def crc(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode_frame(body: bytes) -> bytes:
    """Return the frame of a body, with the zero byte that ends it."""
    encoded: bytes = cobs.encode(body + crc(body).to_bytes(CRC_BYTES, "little"))
    return encoded + b"\0"


def decode_frame(encoded: bytes) -> bytes:
    """Return the body of a frame without its zero byte. Raises WireError with the cause."""
    try:
        decoded: bytes = cobs.decode(encoded)
    except cobs.DecodeError:
        raise WireError("framing", "not COBS") from None
    body, check = decoded[:-CRC_BYTES], decoded[-CRC_BYTES:]
    if not body:
        raise WireError("framing", f"{len(decoded)} bytes hold nothing")
    if int.from_bytes(check, "little") != crc(body):
        raise WireError("crc", "the CRC does not fit")
    return body


class FrameReader:
    """Bodies of frames from chunks of bytes of any size. Pure.

    Noise costs the frame that it alters; if it hits the zero byte between two frames, both are
    lost.

    Attributes
    ----------
    rejected
        Counts of frames that were altered ("framing", "crc"), and of what came before the first
        zero byte ("partial"): it may be the end of a frame.
    """

    def __init__(self, most_bytes: int, rejected: Counter[str]) -> None:
        """Begin at the next zero byte; most_bytes: length of the longest body."""
        # COBS adds a byte, and another for each 254 bytes.
        self._most_encoded = (most_bytes + CRC_BYTES) * 255 // 254 + 1
        self.rejected = rejected
        self._rest = b""
        self._begun = self._skipping = False

    @property
    def altered(self) -> int:
        """Number of frames that noise has altered."""
        return self.rejected["framing"] + self.rejected["crc"]

    def feed(self, data: bytes) -> list[bytes]:
        """Return the bodies that these bytes complete."""
        *whole, rest = (self._rest + data).split(b"\0")
        bodies = []
        for encoded in whole:
            if encoded and not self._skipping:
                try:
                    bodies.append(decode_frame(encoded))
                except WireError as error:
                    self._reject(error.cause)
            self._skipping, self._begun = False, True
        if len(rest) > self._most_encoded:
            if not self._skipping:
                self._reject("framing")
            self._skipping, rest = True, b""
        self._rest = rest
        return bodies

    def _reject(self, cause: str) -> None:
        self.rejected[cause if self._begun else "partial"] += 1
