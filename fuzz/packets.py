"""What must hold of whatever a sensor's decoder makes of a device's bytes."""

from collections import Counter
from collections.abc import Iterable
from typing import Any, Protocol

from fuzz.refusals import check_causes
from protocol.config.scene import validate
from pulse_sensors.lsl_inlet import LslScene
from pulse_sensors.reading import LARGEST, Packet, Readings

TABLE = validate(
    {"kind": "lsl", "stream": "x", "rate": "1 kHz", "unit": "N"}, LslScene, where="fuzz"
)
MS = 1_000_000


class Decoder(Protocol):
    """See pulse_sensors/sensor.py."""

    rejected: Counter[str]

    def feed(self, data: Any) -> list[Packet]:
        """The packets that end in this."""


def check_decoder(decoder: Decoder, data: bytes, piece: int) -> None:
    """Feed bytes in pieces, and check all that comes."""
    pieces = (data[start : start + piece] for start in range(0, len(data), piece))
    check_fed(decoder, pieces)


def check_fed(decoder: Decoder, pieces: Iterable[Any]) -> None:
    """Feed one piece a millisecond; what comes becomes readings that never go back in time."""
    readings, end_ns = Readings(TABLE), None
    for number, piece in enumerate(pieces):
        for packet in decoder.feed(piece):
            assert packet.values
            assert all(abs(value) <= LARGEST for value in packet.values)
            assert packet.missing >= 0
            reading = readings.of(packet, number * MS)
            if reading is not None:
                assert reading.missing >= 0
                assert reading.end_ns > reading.first_ns
                assert end_ns is None or reading.first_ns >= end_ns
                end_ns = reading.end_ns
    check_causes(decoder.rejected)
