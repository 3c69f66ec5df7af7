"""Calibration of a film: readings under reference loads, and the straight line through them.

The loads come from a CSV file, or are put on a live sensor one after the other.
"""

import csv
import re
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from protocol.errors import BenchError, SceneError, SourceError
from protocol.input_files import read_regular
from protocol.tactile import FIG_4_VOLTS_PER_NEWTON, Film
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.sensor import Sensor
from telepulse.commissioning.rig import listen
from telepulse.document import Chapter, Plot, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
TableT = TypeVar("TableT", bound=SensorTable)
LoadUnit = Literal["N", "mN", "g", "kg"]
ReadingUnit = Literal["V", "mV", "counts"]

# Units in N: weights press with their mass times standard gravity. Volts are kept in volts.
LOADS: dict[str, float] = {"N": 1.0, "mN": 1e-3, "g": 9.80665e-3, "kg": 9.80665}
READINGS: dict[str, float] = {"V": 1.0, "mV": 1e-3, "counts": 1.0}
# The names of the columns in a header, and their units.
COLUMNS = (
    ("load", ("load", "force", "weight", "mass"), LOADS),
    ("reading", ("reading", "voltage", "volts", "output", "counts"), READINGS),
)
_HEADER = re.compile(r"\s*([A-Za-z]+)(?:[\s_]*[\[(]?([A-Za-z]+)[\])]?)?\s*")
# A larger number could become infinite when multiplied by its unit's factor.
LARGEST = 1e30
LEAST_LOADS = 3
# Slope over its standard error; noise alone gives less.
LEAST_SIGNIFICANCE = 3.0
AVERAGE_S = 2.0
SETTLE_S = 0.5
TRIES = 3
# Largest table of loads that is read: some 100 000 rows.
MOST_BYTES = 1 << 21
# Radius of the film under the finger in Table 1 of the paper (docs/explanation/paper.md).
RADIUS_M = 9e-3


@dataclass(frozen=True, slots=True)
class LoadReadings:
    """Loads in N and the readings under them, in V or counts, in the order they were taken."""

    load_n: Array
    reading: Array
    unit: Literal["V", "counts"]


def read_loads(
    path: Path, load_unit: LoadUnit | None, reading_unit: ReadingUnit | None
) -> LoadReadings:
    """Read a CSV file of two columns or more.

    A header names load and reading, and may name their units: `load (g), reading_mV`. Without
    one, the first two columns are taken. A unit given as an argument overrides the header's;
    without either, loads are in N and readings in mV. Raises SourceError with the line's number.
    """
    try:
        text = read_regular(path, MOST_BYTES).decode("utf-8-sig")
        rows = [
            (number, row)
            for number, row in enumerate(csv.reader(text.splitlines()), 1)
            if any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#")
        ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise SourceError(f"{path}: cannot be read: {reason}") from None
    if not rows:
        raise SourceError(f"{path}: the file is empty")
    found = [(0, ""), (1, "")]
    if not _is_number(rows[0][1][0]):
        found = _read_header(path, *rows.pop(0))
    load_in, reading_in = load_unit or found[0][1] or "N", reading_unit or found[1][1] or "mV"
    pairs = np.empty((len(rows), 2))
    for pair, (number, row) in zip(pairs, rows, strict=True):
        if len(row) <= max(found)[0]:
            raise SourceError(f"{path}:{number}: {len(row)} columns; load and reading are needed")
        for i, (column, _) in enumerate(found):
            if not _is_number(row[column]):
                raise SourceError(
                    f"{path}:{number}: {row[column].strip()!r:.40} is not a number that can be used"
                )
            pair[i] = float(row[column])
    return LoadReadings(
        pairs[:, 0] * LOADS[load_in],
        pairs[:, 1] * READINGS[reading_in],
        "counts" if reading_in == "counts" else "V",
    )


def _read_header(path: Path, number: int, row: list[str]) -> list[tuple[int, str]]:
    """Return the columns of load and reading, and their units where the header names them."""
    cells = [_HEADER.fullmatch(cell) for cell in row]
    found = []
    for what, names, known in COLUMNS:
        matches = ((i, m[2] or "") for i, m in enumerate(cells) if m and m[1].lower() in names)
        column, unit = next(matches, (-1, ""))
        if column < 0:
            raise SourceError(f"{path}:{number}: no column for the {what}; name it {names[0]!r}")
        if unit and unit not in known:
            allowed = ", ".join(known)
            raise SourceError(f"{path}:{number}: unknown unit {unit!r}; known: {allowed}")
        found.append((column, unit))
    return found


def _is_number(cell: str) -> bool:
    try:
        return abs(float(cell)) <= LARGEST
    except ValueError:
        return False


def parse_loads(text: str) -> list[float]:
    """Return loads such as "0, 0.5, 1 N" or "0, 20, 50 g" in N. Raises SceneError."""
    *others, last = (part.strip() for part in text.split(","))
    number, _, unit = last.rpartition(" ")
    if unit not in LOADS:
        known = ", ".join(LOADS)
        raise SceneError(f"--loads: {text!r} must end with a unit, one of {known}")
    try:
        return [float(part) * LOADS[unit] for part in (*others, number)]
    except ValueError:
        raise SceneError(f"--loads: {text!r} must be numbers with commas between them") from None


def measure_loads(
    scene: TableT,
    opened: Callable[[TableT], Sensor],
    loads_n: list[float],
    ask: Callable[[float], None],
    channel: str | None = None,
) -> LoadReadings:
    """Average a channel's reading under each load; `ask` returns once that load is on.

    opened: opens the sensor of a table, for this function to close. channel: its name; None for the
    only channel of force. Raises SourceError when the sensor is not there, and BenchError when it
    sends nothing or its reading does not settle.
    """
    if scene.unit not in READINGS:
        raise SceneError(f'the sensor\'s unit is "{scene.unit}": it is calibrated already')
    forces = [each.name for each in scene.wire_channels if not each.announces]
    if channel not in forces and (channel is not None or len(forces) > 1):
        given = "several channels" if channel is None else f"no channel {channel!r}"
        raise SceneError(f"the sensor has {given}: choose with --channel one of {forces}")
    # With the unit N, the sensor's own numbers come through unscaled.
    raw = scene.model_copy(update={"unit": "N", "preload_n": 0.0})
    readings = []
    with closing(opened(raw)) as sensor:
        for load_n in loads_n:
            ask(load_n)
            readings.append(_settled_reading(sensor, channel or forces[0], load_n))
    return LoadReadings(
        np.array(loads_n),
        np.array(readings) * READINGS[scene.unit],
        "counts" if scene.unit == "counts" else "V",
    )


def is_moving(reading: Array) -> bool:
    """Return whether a reading's two halves differ by more than the noise within them."""
    first, second = np.array_split(reading, 2)
    noise = np.sqrt((first.var() + second.var()) / 2)
    return bool(abs(second.mean() - first.mean()) > noise)


def _settled_reading(sensor: Sensor, channel: str, load_n: float) -> float:
    for _ in range(TRIES):
        time.sleep(SETTLE_S)
        reading = listen(sensor, AVERAGE_S)[channel].force_n
        if not is_moving(reading):
            return float(reading.mean())
    raise BenchError(
        f"at {load_n:g} N the reading is still moving after {TRIES} tries: let the load rest; a"
        " charge amplifier cannot hold a static load, calibrate without it"
    )


@dataclass(frozen=True, slots=True)
class CalibrationLine:
    """Least squares line: reading = slope · load + offset, in the readings' unit and N.

    slope_error, offset_error: standard errors. residual_n: residual of each reading as a force,
    in the order of the loads; rms_n: their RMS, for the two degrees of freedom of the line.
    hysteresis_n: largest difference, at one load, between readings reached from below and from
    above; None if no load was reached from both sides. repeatability_n: standard deviation of
    readings at the same load, reached from the same side; None if no load was repeated so.
    """

    slope: float
    offset: float
    slope_error: float
    offset_error: float
    r_squared: float
    residual_n: Array
    rms_n: float
    hysteresis_n: float | None
    repeatability_n: float | None


def fit_line(load_n: Array, reading: Array) -> CalibrationLine:
    """Fit the line through loads in the order in which they were put on, shape (n,) each.

    Raises BenchError for fewer than 3 loads, for equal loads, and for readings that do not
    change with them.
    """
    from scipy.stats import linregress

    count = len(load_n)
    if count < LEAST_LOADS:
        raise BenchError(f"{count} loads; at least {LEAST_LOADS} are needed for a line")
    if not np.ptp(load_n):
        raise BenchError(f"all loads are {load_n[0]:g} N; different ones are needed for a line")
    line = linregress(load_n, reading)
    if not abs(line.slope) > LEAST_SIGNIFICANCE * line.stderr:
        raise BenchError(
            "the readings do not change with the loads: check that they press the sensor, and its"
            " cable"
        )
    off_n = (reading - line.slope * load_n - line.intercept) / line.slope
    hysteresis_n, repeatability_n = _spreads_n(load_n, off_n)
    return CalibrationLine(
        slope=float(line.slope),
        offset=float(line.intercept),
        slope_error=float(line.stderr),
        offset_error=float(line.intercept_stderr),
        r_squared=float(line.rvalue**2),
        residual_n=off_n,
        rms_n=float(np.sqrt(np.sum(off_n**2) / (count - 2))),
        hysteresis_n=hysteresis_n,
        repeatability_n=repeatability_n,
    )


def _spreads_n(load_n: Array, off_n: Array) -> tuple[float | None, float | None]:
    """Return hysteresis and repeatability; None where the loads do not show them."""
    side, sides = 1.0, []
    for before, after in zip([0.0, *load_n[:-1].tolist()], load_n.tolist(), strict=True):
        # A repeated load keeps the side from which it was reached.
        side = np.sign(after - before) or side
        sides.append(side)
    rising = np.array(sides) > 0
    gaps_n = [
        abs(float(off_n[same & rising].mean() - off_n[same & ~rising].mean()))
        for same in (load_n == load for load in np.unique(load_n))
        if (same & rising).any() and (same & ~rising).any()
    ]
    groups = np.unique(np.stack([load_n, rising]), axis=1, return_inverse=True)[1].ravel()
    count = np.bincount(groups)
    freedom, repeatability_n = int(np.sum(count - 1)), None
    if freedom:
        means_n = np.bincount(groups, off_n) / count
        repeatability_n = float(np.sqrt(np.sum((off_n - means_n[groups]) ** 2) / freedom))
    return max(gaps_n, default=None), repeatability_n


def calibration_keys(loads: LoadReadings, line: CalibrationLine) -> str:
    """Return the calibration as keys for a live sensor's table in a scene.

    Raises BenchError for volts that fall under load: a scene's sensitivity is positive.
    """
    if loads.unit == "counts":
        return f"newtons_per_count = {1 / line.slope:.6g}\nzero = {line.offset:.6g}"
    if line.slope < 0:
        raise BenchError("the voltage falls under load: swap the film's wires")
    return f'sensitivity = "{line.slope * 1e3:.5g} mV/N"\noffset = "{line.offset * 1e3:.5g} mV"'


def report_calibration(name: str, loads: LoadReadings, line: CalibrationLine) -> Report:
    """Return the report of a calibration."""
    scale, unit = (1e3, "mV") if loads.unit == "V" else (1.0, "counts")
    fitted = line.slope * loads.load_n + line.offset
    columns = zip(loads.load_n, loads.reading, fitted, line.residual_n, strict=True)
    rows = tuple(
        (f"{load:.4g} N", f"{reading * scale:.5g}", f"{fit * scale:.5g}", f"{off * 1e3:+.2f} mN")
        for load, reading, fit, off in columns
    )
    table = Table(
        f"Loads and readings: {name}", ("load", f"reading, {unit}", "line", "residual"), rows
    )

    def milli(value_n: float | None) -> str:
        return "needs a repeated load" if value_n is None else f"{value_n * 1e3:.2f} mN"

    figures = (
        ("slope", f"{line.slope * scale:.5g} ± {line.slope_error * scale:.2g} {unit}/N"),
        ("offset", f"{line.offset * scale:.4g} ± {line.offset_error * scale:.2g} {unit}"),
        ("R²", f"{line.r_squared:.6f}"),
        ("residual, RMS", milli(line.rms_n)),
        ("residual, largest", milli(float(np.max(np.abs(line.residual_n))))),
        ("hysteresis", milli(line.hysteresis_n)),
        ("repeatability", milli(line.repeatability_n)),
    )
    note = "±: standard errors"
    if loads.unit == "V":
        note += (
            f"; Fig. 4 of Dargahi et al. (2008) has {FIG_4_VOLTS_PER_NEWTON * 1e3:.0f} mV/N, and eq"
            f" 21 gives a 9 mm film {Film(RADIUS_M).volts_per_newton * 1e3:.0f} mV/N without an"
            " amplifier"
        )
    tables = (table, Table("line", ("", ""), figures, note=note))

    def draw(figure: "Figure") -> None:
        ends_n = np.array([loads.load_n.min(), loads.load_n.max()])
        reading, off = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        reading.plot(ends_n, (line.slope * ends_n + line.offset) * scale, label="line")
        reading.plot(loads.load_n, loads.reading * scale, "o", label="readings")
        reading.set(ylabel=f"reading in {unit}")
        reading.legend(loc="upper left")
        off.plot(loads.load_n, line.residual_n * 1e3, "o")
        off.axhline(0.0, linewidth=1.0)
        off.set(xlabel="load in N", ylabel="residual in mN")

    plot = Plot("line", "Readings under reference loads, and the line through them.", draw)
    return Report(f"Calibration of {name}", (Chapter("Line", tables=tables, plots=(plot,)),))
