"""A calibration as tables, a plot, and the lines for a scene."""

from typing import TYPE_CHECKING

import numpy as np

from protocol.calibration import FIG_4_VOLTS_PER_NEWTON
from protocol.errors import BenchError
from protocol.tactile import Film
from telepulse.commissioning.calibration.line import CalibrationLine
from telepulse.commissioning.calibration.loads import Loads
from telepulse.reports.document import Chapter, Plot, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Table 1's film under the finger.
RADIUS_M = 9e-3


def report_calibration(name: str, loads: Loads, line: CalibrationLine) -> Report:
    """The report of a calibration."""
    scale, unit = _shown(loads)
    fitted = line.slope * loads.load_n + line.offset
    rows = tuple(
        (f"{load:.4g} N", f"{reading * scale:.5g}", f"{fit * scale:.5g}", f"{off * 1e3:+.2f} mN")
        for load, reading, fit, off in zip(
            loads.load_n, loads.reading, fitted, line.residual_n, strict=True
        )
    )
    table = Table(f"loads of {name}", ("load", f"reading, {unit}", "line", "residual"), rows)
    return Report(
        f"Calibration of {name}",
        (
            Chapter(
                "CalibrationLine",
                tables=(table, _line_table(loads, line)),
                plots=(_plot(loads, line),),
            ),
        ),
    )


def scene_lines(loads: Loads, line: CalibrationLine) -> str:
    """The line as the table of a live sensor says it.

    Raises BenchError for volts that fall under load: no scene has a negative sensitivity.
    """
    if loads.unit == "counts":
        return f"newtons_per_count = {1 / line.slope:.6g}\nzero = {line.offset:.6g}"
    if line.slope < 0:
        raise BenchError("the voltage falls under load: swap the film's wires")
    return f'sensitivity = "{line.slope * 1e3:.5g} mV/N"\noffset = "{line.offset * 1e3:.5g} mV"'


def _line_table(loads: Loads, line: CalibrationLine) -> Table:
    scale, unit = _shown(loads)
    none = "no load came twice so"
    rows = [
        ("slope", f"{line.slope * scale:.5g} ± {line.slope_error * scale:.2g} {unit}/N"),
        ("offset", f"{line.offset * scale:.4g} ± {line.offset_error * scale:.2g} {unit}"),
        ("R²", f"{line.r_squared:.6f}"),
        ("off the line, RMS", f"{line.rms_n * 1e3:.2f} mN"),
        ("off the line, largest", f"{line.largest_n * 1e3:.2f} mN"),
        ("hysteresis", none if line.hysteresis_n is None else f"{line.hysteresis_n * 1e3:.2f} mN"),
        (
            "repeatability",
            none if line.repeatability_n is None else f"{line.repeatability_n * 1e3:.2f} mN",
        ),
    ]
    note = "±: standard errors"
    if loads.unit == "V":
        eq_21 = Film(RADIUS_M).volts_per_newton
        note += (
            f"; Fig. 4 has {FIG_4_VOLTS_PER_NEWTON * 1e3:.0f} mV/N, eq 21 gives a 9 mm film"
            f" {eq_21 * 1e3:.0f} mV/N without an amplifier"
        )
    return Table("line", ("", ""), tuple(rows), note=note)


def _shown(loads: Loads) -> tuple[float, str]:
    return (1e3, "mV") if loads.unit == "V" else (1.0, "counts")


def _plot(loads: Loads, line: CalibrationLine) -> Plot:
    def draw(figure: "Figure") -> None:
        scale, unit = _shown(loads)
        ends_n = np.array([loads.load_n.min(), loads.load_n.max()])
        reading, off = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        reading.plot(ends_n, (line.slope * ends_n + line.offset) * scale, label="line")
        reading.plot(loads.load_n, loads.reading * scale, "o", label="readings")
        reading.set(ylabel=f"reading in {unit}")
        reading.legend(loc="upper left")
        off.plot(loads.load_n, line.residual_n * 1e3, "o")
        off.axhline(0.0, linewidth=1.0)
        off.set(xlabel="load in N", ylabel="residual in mN")

    return Plot("line", "Readings under reference loads, and the line through them.", draw)
