"""What a decoder makes of a device's bytes, before its times are on the host's clock."""

from dataclasses import dataclass

# Beyond it, NaN included, no unit of a sensor leaves a force that a frame can carry.
LARGEST = 1e30


@dataclass(frozen=True, slots=True)
class Packet:
    """Consecutive samples in the sensor's own unit, at least one.

    device_ns: the device's clock at the last of them; None from a device that sends no time.
    missing: samples that were lost right before them, as far as the bytes tell.
    anew: the device's clock has nothing to do with what it said before.
    """

    values: tuple[float, ...]
    device_ns: int | None = None
    missing: int = 0
    anew: bool = False
