"""Binary frames of a sensor board: a sample counter, the device's time, samples.

Frames are those of `protocol.serial_frames`. A body is, in little-endian order:

    format 1 byte | counter 4 | time 4 | samples

format: 16 times the number of a sample's values, plus 1 for int16, 2 for int32, 3 for float32; so
a board with one channel of int16 sends 0x11, one with three 0x31. counter: number of the first
sample. samples: their values one after the other. time: the device's micros() at the last sample.
Counter and time wrap to 0 after 2^32. A frame has at most `MAX_SAMPLES` samples.
"""

import struct
from collections import Counter
from typing import Literal

import numpy as np

from protocol.config.quantities import count_text
from protocol.errors import WireError
from protocol.serial_frames import FrameReader, encode_frame
from pulse_sensors.sample_plausibility import is_usable
from pulse_sensors.samples import (
    DecodedBlock,
    DeviceTime,
    SampleCounter,
    Values,
    decoded_block,
    quoted,
)

SampleFormat = Literal["int16", "int32", "float32"]

MAX_SAMPLES = 64
_CODES: dict[SampleFormat, int] = {"int16": 1, "int32": 2, "float32": 3}
_DTYPES = {code: np.dtype(name).newbyteorder("<") for name, code in _CODES.items()}
_CHANNELS_SHIFT, _CODE_MASK = 4, 0x0F
_LINE_ENDS = str.maketrans("\r\n\t", "   ")
_HEAD = struct.Struct("<BII")


class FrameEncoder:
    """Encoder of a board's samples, numbered from 0."""

    def __init__(self, sample_format: SampleFormat, channels: int = 1) -> None:
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
        return encode_frame(head + samples.astype(dtype).tobytes())


class FrameDecoder:
    """Decoder of a board's frames, from chunks of any size. Pure.

    rejected: counts of `serial_frames.FrameReader`, and of bodies that are no samples. Frames with
    another number of values in a sample than `channels` are rejected.
    """

    def __init__(self, period_ns: int, channels: int = 1) -> None:
        self._channels = channels
        self._most_bytes = _HEAD.size + 4 * MAX_SAMPLES * channels
        self._period_ns = period_ns
        self.rejected: Counter[str] = Counter()
        # The newest bytes without a frame, and why the newest body is no sample.
        self._unread, self._no_sample = b"", WireError("format", "")
        self.reset()

    def reset(self) -> None:
        """Start anew with the next bytes, for example after the cable was unplugged."""
        self._reader = FrameReader(self._most_bytes, self.rejected)
        self._time = DeviceTime()
        self._counter = SampleCounter(1 << 32, self._period_ns, self.rejected)

    @property
    def refused(self) -> dict[str, str]:
        """A sentence for each cause of `rejected`, with its newest bytes and what to set."""
        error, unread = self._no_sample, self._unread
        is_text = unread.isascii() and unread.decode().translate(_LINE_ENDS).isprintable()
        advice = 'set framing = "text"' if is_text else "set baud to that of the board"
        no_frame = f"the bytes {quoted(unread)} hold no frame: {advice}"
        return {
            error.cause: str(error),
            **dict.fromkeys(("crc", "partial", "framing"), no_frame),
        }

    def feed(self, data: bytes) -> list[DecodedBlock]:
        """Return the blocks that these bytes complete."""
        blocks, bodies = [], self._reader.feed(data)
        if not bodies:
            self._unread = data
        for body in bodies:
            try:
                blocks.append(self._decode(body))
            except WireError as error:
                self.rejected[error.cause] += 1
                self._no_sample = error
        return blocks

    def _decode(self, body: bytes) -> DecodedBlock:
        """Decode a frame's body. Raises WireError with the cause."""
        payload_bytes = len(body) - _HEAD.size
        if payload_bytes <= 0:
            raise WireError("framing", f"{len(body)} bytes hold no sample")
        code, counter, last_us = _HEAD.unpack_from(body)
        dtype, channels = _DTYPES.get(code & _CODE_MASK), code >> _CHANNELS_SHIFT
        if (
            dtype is None
            or channels != self._channels
            or payload_bytes % (channels * dtype.itemsize)
        ):
            raise WireError(
                "format",
                f"the frame {quoted(body)} has format {code:#x}, so {count_text(channels, 'value')}"
                f" a sample, and the scene {self._channels}: set names, one for each value, or"
                " check the board's program",
            )
        count = payload_bytes // (channels * dtype.itemsize)
        values = np.frombuffer(body, dtype, count * channels, _HEAD.size)
        if not all(map(is_usable, values.tolist())):
            raise WireError(
                "not_finite",
                f"the frame {quoted(body)} has a sample that is NaN, infinite or too large"
                " whatever its unit: check the board's program",
            )
        passed_ns = self._time.since_last_ns(last_us)
        missing = self._counter.missing(counter, count, passed_ns)
        rows = values.reshape(count, channels).tolist()
        return decoded_block(rows, self._time.take(last_us), missing, restarted=passed_ns is None)
