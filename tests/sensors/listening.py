"""Waiting for what a live sensor's thread hears."""

import time
from collections.abc import Callable

from sensors.reading import Reading
from sensors.sensor import Sensor

PATIENCE_S = 20


def until(done: Callable[[], bool]) -> None:
    """Wait for something that happens in another thread or process."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < give_up_s, "it never came"
        time.sleep(0.005)


def heard(sensor: Sensor, count: int) -> list[Reading]:
    """Poll until `count` samples have come."""
    readings: list[Reading] = []

    def enough() -> bool:
        readings.extend(sensor.poll())
        return sum(len(reading.force_n) for reading in readings) >= count

    until(enough)
    return readings


def forces(readings: list[Reading]) -> list[float]:
    return [force_n for reading in readings for force_n in reading.force_n]
