"""Readings of a live sensor under loads that a person puts on, one after the other.

A table of reference loads and readings, from a CSV file.
"""

import csv
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from protocol.errors import BenchError, SceneError, SourceError
from pulse_sensors.scene import SensorScene, open_sensor
from pulse_sensors.sensor import Sensor
from telepulse.commissioning.calibration.line import Array
from telepulse.commissioning.hardware import listen

STANDARD_GRAVITY = 9.80665
LoadUnit = Literal["N", "mN", "g", "kg"]
ReadingUnit = Literal["V", "mV", "counts"]
# Weights press with their mass times standard gravity; volts are kept in volts.
LOADS: dict[str, float] = {
    "N": 1.0,
    "mN": 1e-3,
    "g": 1e-3 * STANDARD_GRAVITY,
    "kg": STANDARD_GRAVITY,
}
READINGS: dict[str, float] = {"V": 1.0, "mV": 1e-3, "counts": 1.0}
LOAD_NAMES = ("load", "force", "weight", "mass")
READING_NAMES = ("reading", "voltage", "volts", "output", "counts")
# Beyond it no unit's factor leaves a number that is finite.
LARGEST = 1e30
_HEADER = re.compile(r"\s*([A-Za-z]+)(?:[\s_]*[\[(]?([A-Za-z]+)[\])]?)?\s*")


@dataclass(frozen=True, slots=True)
class Loads:
    """Loads in N and the readings under them, in V or counts, in the order they were taken."""

    load_n: Array
    reading: Array
    unit: Literal["V", "counts"]


def read_loads(path: Path, load_unit: LoadUnit | None, reading_unit: ReadingUnit | None) -> Loads:
    """Read a CSV file of two columns or more.

    A header names load and reading, and may name their units: `load (g), reading_mV`. Without
    one the first two columns are taken. Units that neither it nor the arguments name are N and
    mV. Raises SourceError with the line's number.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        rows = [
            (number, row)
            for number, row in enumerate(csv.reader(text.splitlines()), 1)
            if any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#")
        ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SourceError(f"{path}: cannot be read: {error}") from None
    if not rows:
        raise SourceError(f"{path}: it is empty")
    columns, header_units = (0, 1), ("", "")
    if not _is_number(rows[0][1][0]):
        columns, header_units = _read_header(path, *rows.pop(0))
    load_in = load_unit or header_units[0] or "N"
    reading_in = reading_unit or header_units[1] or "mV"
    pairs = np.array(list(_pairs(path, rows, columns))).reshape(-1, 2)
    return Loads(
        pairs[:, 0] * LOADS[load_in],
        pairs[:, 1] * READINGS[reading_in],
        "counts" if reading_in == "counts" else "V",
    )


def _read_header(
    path: Path, number: int, row: list[str]
) -> tuple[tuple[int, int], tuple[str, str]]:
    """Columns of load and reading, and their units where it names them."""
    columns, units = [], []
    for what, names, known in (
        ("load", LOAD_NAMES, LOADS),
        ("reading", READING_NAMES, READINGS),
    ):
        for column, cell in enumerate(row):
            match = _HEADER.fullmatch(cell)
            if match is not None and match.group(1).lower() in names:
                unit = match.group(2) or ""
                if unit and unit not in known:
                    allowed = ", ".join(known)
                    raise SourceError(f"{path}:{number}: unknown unit {unit!r}; known: {allowed}")
                columns.append(column)
                units.append(unit)
                break
        else:
            raise SourceError(f"{path}:{number}: no column for the {what}; name it {names[0]!r}")
    return (columns[0], columns[1]), (units[0], units[1])


def _pairs(
    path: Path, rows: list[tuple[int, list[str]]], columns: tuple[int, int]
) -> Iterator[tuple[float, float]]:
    for number, row in rows:
        if len(row) <= max(columns):
            raise SourceError(f"{path}:{number}: {len(row)} columns; load and reading are needed")
        for column in columns:
            if not _is_number(row[column]):
                raise SourceError(
                    f"{path}:{number}: {row[column].strip()!r:.40} is not a number that can be used"
                )
        yield float(row[columns[0]]), float(row[columns[1]])


def _is_number(cell: str) -> bool:
    try:
        return abs(float(cell)) <= LARGEST
    except ValueError:
        return False


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
