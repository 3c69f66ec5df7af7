"""Waiting for what a live sensor's thread hears."""

from pulse_sensors.reading import Reading
from pulse_sensors.sensor import Sensor
from tests.support.waiting import until


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
