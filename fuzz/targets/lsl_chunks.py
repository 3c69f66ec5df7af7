"""Chunks of a Lab Streaming Layer stream: pairs of doubles, a value and its time."""

import struct
from collections.abc import Iterator

from fuzz.packets import check_fed
from pulse_sensors.lsl_inlet import Chunk, LslDecoder

_SAMPLE = struct.Struct("<dd")
CHUNK = 8


def seeds() -> list[bytes]:
    """Return samples on time, and some that are not numbers."""
    values = [0.0, 0.5, float("nan"), 1e31, -0.5] * 4
    return [b"".join(_SAMPLE.pack(value, 1e-3 * n) for n, value in enumerate(values))]


def try_one(data: bytes) -> None:
    """Convert any values at any times."""
    check_fed(LslDecoder((0,)), _chunks(data))


def _chunks(data: bytes) -> Iterator[Chunk]:
    samples = list(_SAMPLE.iter_unpack(data[: len(data) // _SAMPLE.size * _SAMPLE.size]))
    for start in range(0, len(samples), CHUNK):
        some = samples[start : start + CHUNK]
        yield Chunk([[value] for value, _ in some], [time_s for _, time_s in some])
