"""Properties that hold of everything a sensor's decoder makes of a device's bytes."""

from collections import Counter
from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np

from fuzz.refusals import check_causes
from protocol.config.scene import validate
from pulse_sensors.lsl_inlet import LslScene
from pulse_sensors.sample_plausibility import LARGEST
from pulse_sensors.samples import DecodedBlock, Timestamper

TABLE = validate(
    {"kind": "lsl", "stream": "x", "rate": "1 kHz", "unit": "N"}, LslScene, where="fuzz"
)
MS = 1_000_000


class Decoder(Protocol):
    """See pulse_sensors/sensor.py."""

    rejected: Counter[str]

    def feed(self, data: Any) -> list[DecodedBlock]:
        """Return the blocks that these bytes complete."""


def check_decoder(decoder: Decoder, data: bytes, piece: int) -> None:
    """Feed bytes in pieces, and check all packets."""
    pieces = (data[start : start + piece] for start in range(0, len(data), piece))
    check_fed(decoder, pieces)


def check_fed(decoder: Decoder, pieces: Iterable[Any]) -> None:
    """Feed one piece a millisecond; blocks are timestamped in order of time."""
    timestamper, end_ns = Timestamper(TABLE), None
    for number, piece in enumerate(pieces):
        for block in decoder.feed(piece):
            assert len(block.values)
            assert (np.abs(block.values) <= LARGEST).all()
            assert block.missing >= 0
            timestamped = timestamper.timestamp(block, number * MS)
            if timestamped is not None:
                assert timestamped.missing >= 0
                assert timestamped.end_ns > timestamped.first_ns
                assert end_ns is None or timestamped.first_ns >= end_ns
                end_ns = timestamped.end_ns
    check_causes(decoder.rejected)
