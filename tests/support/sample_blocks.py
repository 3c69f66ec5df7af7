"""Blocks of samples, in a form that tests compare, and from a live sensor."""

from collections.abc import Iterable
from typing import NamedTuple

from pulse_sensors.samples import DecodedBlock, SampleBlock
from pulse_sensors.sensor import Sensor
from tests.support.waiting import until


class Decoded(NamedTuple):
    """A block of samples of one channel."""

    values: tuple[float, ...]
    device_ns: int | None = None
    missing: int = 0
    restarted: bool = False


def plain(blocks: Iterable[DecodedBlock]) -> list[Decoded]:
    return [Decoded(tuple(block.values[:, 0].tolist()), *block[1:]) for block in blocks]


def values(blocks: Iterable[Decoded]) -> list[float]:
    return [value for block in blocks for value in block.values]


def forces(blocks: Iterable[DecodedBlock | SampleBlock]) -> list[float]:
    return [force_n for block in blocks for force_n in block.values[:, 0].tolist()]


def received(sensor: Sensor, count: int) -> list[SampleBlock]:
    """Poll until `count` samples have come."""
    blocks: list[SampleBlock] = []

    def enough() -> bool:
        blocks.extend(sensor.poll())
        return len(forces(blocks)) >= count

    until(enough)
    return blocks


def await_log(sensor: Sensor, logged: list[str]) -> None:
    """Poll until a message is logged."""

    def enough() -> bool:
        sensor.poll()
        return bool(logged)

    until(enough)
