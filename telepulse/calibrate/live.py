"""Readings of a live sensor under loads that a person puts on, one after the other."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from protocol.errors import BenchError, SceneError
from sensors.scene import SensorScene, open_sensor
from sensors.sensor import Sensor
from telepulse.bench.hardware import listen
from telepulse.calibrate.line import Array
from telepulse.calibrate.loads import LOADS, READINGS, Loads

AVERAGE_S = 2.0
SETTLE_S = 0.5
TRIES = 3


def parse_loads(text: str) -> list[float]:
    """Loads such as "0, 0.5, 1 N" or "0, 20, 50 g" in N. Raises SceneError."""
    *others, last = (part.strip() for part in text.split(","))
    number, _, unit = last.rpartition(" ")
    if unit not in LOADS:
        known = ", ".join(LOADS)
        raise SceneError(f"--loads: {text!r} must end with a unit, one of {known}")
    try:
        return [float(part) * LOADS[unit] for part in (*others, number)]
    except ValueError:
        raise SceneError(f"--loads: {text!r} must be numbers with commas between them") from None


def take_loads(
    scene: SensorScene, folder: Path, loads_n: list[float], ask: Callable[[float], None]
) -> Loads:
    """Average the sensor under each load, after `ask` has said that it is on.

    Raises SourceError when the sensor is not there, and BenchError when it says nothing or its
    reading goes on moving.
    """
    if scene.unit not in READINGS:
        raise SceneError(f'the sensor\'s unit is "{scene.unit}": it is calibrated already')
    # Read as if its unit were newtons, a sensor gives what it sends.
    raw = scene.model_copy(update={"unit": "N", "preload_n": 0.0})
    sensor = open_sensor(raw, folder, print)
    try:
        readings = []
        for load_n in loads_n:
            ask(load_n)
            readings.append(_still_reading(sensor, load_n))
    finally:
        sensor.close()
    return Loads(
        np.array(loads_n),
        np.array(readings) * READINGS[scene.unit],
        "counts" if scene.unit == "counts" else "V",
    )


def is_moving(reading: Array) -> bool:
    """Whether a reading's two halves differ by more than its noise does about them."""
    first, second = np.array_split(reading, 2)
    noise = np.sqrt((first.var() + second.var()) / 2)
    return bool(abs(second.mean() - first.mean()) > noise)


def _still_reading(sensor: Sensor, load_n: float) -> float:
    for _ in range(TRIES):
        time.sleep(SETTLE_S)
        heard = listen(sensor, AVERAGE_S).force_n
        if not is_moving(heard):
            return float(heard.mean())
    raise BenchError(
        f"at {load_n:g} N the reading is still moving after {TRIES} tries: let the load rest; a"
        " charge amplifier cannot hold a static load, calibrate without it"
    )
