"""Binary frames of a sensor board: COBS, a sample counter, the device's time, a CRC.

Frames are COBS-encoded and separated by zero bytes. Before encoding, a frame is, in little-endian
order:

    format 1 byte | counter 4 | time 4 | samples | CRC 2

format: 16 times the number of a sample's values, plus 1 for int16, 2 for int32, 3 for float32; so
a board with one channel of int16 sends 0x11, one with three 0x31. counter: number of the first
sample. samples: their values one after the other. time: the device's micros() at the last sample.
CRC: CRC-16/CCITT-FALSE of all bytes before it. Counter and time wrap to 0 after 2^32. A frame has
at most `MAX_SAMPLES` samples.
"""

import binascii
import struct
from collections import Counter
from typing import Literal

import numpy as np

from protocol.errors import WireError
from pulse_sensors import library
from pulse_sensors.plausibility import is_usable
from pulse_sensors.samples import DeviceTime, SampleBlock, SampleCounter, Values, decoded_block

SampleFormat = Literal["int16", "int32", "float32"]

MAX_SAMPLES = 64
_CODES: dict[SampleFormat, int] = {"int16": 1, "int32": 2, "float32": 3}
_DTYPES = {code: np.dtype(name).newbyteorder("<") for name, code in _CODES.items()}
_CHANNELS_SHIFT, _CODE_MASK = 4, 0x0F
_HEAD = struct.Struct("<BII")
_CRC_BYTES = 2


class FrameEncoder:
    """Encoder of a board's samples, numbered from 0. Raises SourceError without cobs."""

    def __init__(self, sample_format: SampleFormat, channels: int = 1) -> None:
        self._cobs = library("cobs.cobs", 'framing = "binary"')
        self._dtype = _DTYPES[_CODES[sample_format]]
        self._code = channels << _CHANNELS_SHIFT | _CODES[sample_format]
        self._counter = 0

    def frame(self, values: Values, last_us: int) -> bytes:
        """Return a frame of 1 to 64 samples, each a number, or as many as there are channels.

        Integer formats round them and limit them to their range. last_us: device's time at the
        last one.
        """
        dtype = self._dtype
        samples = np.asarray(values, dtype=np.float64)
        if dtype.kind == "i":
            limits = np.iinfo(dtype)
            samples = np.clip(np.rint(samples), limits.min, limits.max)
        head = _HEAD.pack(self._code, self._counter, last_us & 0xFFFF_FFFF)
        self._counter = self._counter + len(samples) & 0xFFFF_FFFF
        body = head + samples.astype(dtype).tobytes()
        encoded: bytes = self._cobs.encode(body + struct.pack("<H", crc(body)))
        return encoded + b"\0"


class FrameDecoder:
    """Decoder of a board's frames, from chunks of any size. Pure.

    Noise costs the frame that it corrupts; if it hits the zero byte between two frames, both are
    lost. Bytes before the first zero byte may be the end of a partly received frame, so a decoding
    error in them counts as "partial" only. Frames with another number of values in a sample than
    `channels` are rejected. Raises SourceError without cobs.
    """

    def __init__(self, period_ns: int, channels: int = 1) -> None:
        self._channels = channels
        # COBS adds a byte, and another for each 254 bytes.
        most_bytes = _HEAD.size + 4 * MAX_SAMPLES * channels + _CRC_BYTES
        self._most_bytes = most_bytes * 255 // 254 + 1
        self._cobs = library("cobs.cobs", 'framing = "binary"')
        self._period_ns = period_ns
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Start anew with the next bytes, for example after the cable was unplugged."""
        self._buffer = b""
        self._skipping = self._synchronised = False
        self._time = DeviceTime()
        self._counter = SampleCounter(1 << 32, self._period_ns, self.rejected)

    def feed(self, data: bytes) -> list[SampleBlock]:
        """Return the blocks that these bytes complete."""
        *whole, rest = (self._buffer + data).split(b"\0")
        blocks = []
        for encoded in whole:
            if encoded and not self._skipping:
                try:
                    blocks.append(self._decode(encoded))
                except WireError as error:
                    self.rejected[error.cause if self._synchronised else "partial"] += 1
            self._skipping, self._synchronised = False, True
        if len(rest) > self._most_bytes:
            if not self._skipping:
                self.rejected["framing"] += 1
            self._skipping, rest = True, b""
        self._buffer = rest
        return blocks

    def _decode(self, encoded: bytes) -> SampleBlock:
        """Decode one frame. Raises WireError with the cause."""
        try:
            body: bytes = self._cobs.decode(encoded)
        except self._cobs.DecodeError:
            raise WireError("framing", "not COBS") from None
        payload_bytes = len(body) - _HEAD.size - _CRC_BYTES
        if payload_bytes <= 0:
            raise WireError("framing", f"{len(body)} bytes hold no sample")
        if int.from_bytes(body[-_CRC_BYTES:], "little") != crc(body[:-_CRC_BYTES]):
            raise WireError("crc", "the CRC does not fit")
        code, counter, last_us = _HEAD.unpack_from(body)
        dtype, channels = _DTYPES.get(code & _CODE_MASK), code >> _CHANNELS_SHIFT
        if (
            dtype is None
            or channels != self._channels
            or payload_bytes % (channels * dtype.itemsize)
        ):
            raise WireError("format", f"format {code:#x} with {payload_bytes} bytes of samples")
        count = payload_bytes // (channels * dtype.itemsize)
        values = np.frombuffer(body, dtype, count * channels, _HEAD.size)
        if not all(map(is_usable, values.tolist())):
            raise WireError(
                "not_finite", "a sample is NaN, infinite or too large whatever its unit"
            )
        passed_ns = self._time.since_last_ns(last_us)
        missing = self._counter.missing(counter, count, passed_ns)
        rows = values.reshape(count, channels).tolist()
        return decoded_block(rows, self._time.take(last_us), missing, restarted=passed_ns is None)


def crc(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected."""
    return binascii.crc_hqx(data, 0xFFFF)
