"""Five units for the gains of Table 5, which gives none, each in a loop with the actuator of eq 22.

The loops are in continuous time with a pure derivative, so that only the unit makes a difference.
"""

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter, residue

from protocol.config.scene_file import find_scene
from telepulse.document import Table
from telepulse.paper import published
from telepulse.paper.explicit_loop import least_rate_hz
from telepulse.paper.published import (
    ERROR_UNITS,
    EXPERIMENT,
    FILM_MV,
    FIRST_S,
    GAINS,
    PRINTED,
    SIMULATION,
    ErrorUnit,
    Gains,
    PrintedRmse,
    scientific,
)
from telepulse.paper.pulse_spectrum import beats, deviation_n
from telepulse.scene import load_scene

# Sampling rate in Hz, high enough for the fastest pole, at −4056 /s.
RATE_HZ = 50_000.0
# A loop follows the pulse when its error is below this share of the error of doing nothing.
FOLLOWING = 0.5
MATLAB_FILTER_RAD_PER_S = 100.0
Floats = NDArray[np.float64]


def closed_loop(unit: ErrorUnit, gains: Gains) -> tuple[Floats, Floats]:
    """Return numerator and denominator in s from wanted to felt force: the PID over eq 22."""
    plant = published.ACTUATOR
    opened = unit.per_newton * np.array([gains.kd, gains.kp, gains.ki])
    own = np.array([plant.m, plant.c, plant.k, 0.0])
    return opened, np.polyadd(own, opened)


def poles(unit: ErrorUnit, gains: Gains) -> NDArray[np.complex128]:
    """Return the poles of the closed loop in 1/s, the fastest first."""
    found = np.roots(closed_loop(unit, gains)[1]).astype(np.complex128)
    return found[np.argsort(-np.abs(found))]


def follow(unit: ErrorUnit, gains: Gains, wanted_n: Floats, rate_hz: float = RATE_HZ) -> Floats:
    """Return the felt force in N of a loop that begins at rest, in the shape of `wanted_n`.

    The wanted force is linear between its samples. Exact at the samples: each of the loop's partial
    fractions has its own first-order response to straight lines. scipy's lsim gives the same and
    takes a hundred times as long.
    """
    step_s = 1 / rate_hz
    felt_n = np.zeros(len(wanted_n), np.complex128)
    weights, own_rates, _ = residue(*closed_loop(unit, gains))
    for weight, own_rate in zip(weights, own_rates, strict=True):
        held = expm(step_s * np.array([[own_rate, 1, 0], [0, 0, 1], [0, 0, 0]]))
        kept, level, slope = held[0, 0], weight * held[0, 1], weight * held[0, 2] / step_s
        at_rest = np.array([-slope * wanted_n[0]])
        felt_n += lfilter([slope, level - slope], [1, -kept], wanted_n, zi=at_rest)[0]
    return felt_n.real


def rmse(error: Floats) -> float:
    """Return the root of the mean square over time (eqs 23-25), integrated by trapezoids."""
    return math.sqrt(float(np.trapezoid(error**2)) / (len(error) - 1))


@cache
def relative_rmse(unit: ErrorUnit, gains: Gains, from_rest: bool = True) -> float:
    """Return the RMSE over peak to peak on the paper's pulse in its first 6 s.

    The loop begins at rest, or on the pulse if not `from_rest`.
    """
    wanted_n = beats("paper", RATE_HZ, FIRST_S)
    if not from_rest:
        wanted_n = wanted_n - wanted_n[0]
    return rmse(follow(unit, gains, wanted_n) - wanted_n)


def height_n(unit: ErrorUnit, printed: PrintedRmse) -> float:
    """Return the pulse's height in N peak to peak at which a unit gives a printed figure."""
    return printed.force_n / relative_rmse(unit, printed.gains)


def follows(unit: ErrorUnit) -> bool:
    """Return whether both gain sets leave less than half of the error of doing nothing."""
    worst = max(relative_rmse(unit, gains) for gains in GAINS.values())
    return worst < FOLLOWING * deviation_n("paper")


def ratios() -> list[float]:
    """Return the simulation's error over the experiment's, for each unit."""
    return [
        relative_rmse(unit, SIMULATION) / relative_rmse(unit, EXPERIMENT) for unit in ERROR_UNITS
    ]


def tables() -> dict[str, Table]:
    """Return the error of each unit, the heights that explain it, and the least rates."""
    return {"errors": _errors(), "heights": _heights(), "least-rates": _least_rates()}


def _errors() -> Table:
    doing_nothing = deviation_n("paper")
    first_s = rmse(beats("paper", RATE_HZ, FIRST_S))
    columns = ("error as", "value for 1 N", "simulation's gains", "experiment's gains")
    rows = []
    for unit in ERROR_UNITS:
        simulation, experiment = (relative_rmse(unit, gains) for gains in GAINS.values())
        size, followed = unit.per_newton, "no"
        if follows(unit):
            followed = "yes"
        elif simulation < doing_nothing:
            followed = "no; simulation's gains are a little better than none"
        seen = f"{size:.4g}" if size >= 1 else scientific(size, 4)
        rows.append((unit.name, seen, f"{simulation:.3g}", f"{experiment:.3g}", followed))
    whole = f"over whole beats; {first_s:.3f} over the first {FIRST_S:g} s, which end within a beat"
    rows.append(("doing nothing", "–", f"{doing_nothing:.3f}", f"{doing_nothing:.3f}", whole))
    return Table("", (*columns, "does it follow?"), rows)


def _heights() -> Table:
    def cell(unit: ErrorUnit, printed: PrintedRmse) -> str:
        needed_n = height_n(unit, printed)
        if relative_rmse(unit, printed.gains) >= FOLLOWING * deviation_n("paper"):
            return f"{1e3 * needed_n:.1f} mN; no, does not follow"
        if needed_n > published.CALIBRATION_FORCE_N:
            return f"{needed_n:.3g} N; no, beyond Fig. 4's {published.CALIBRATION_FORCE_N} N"
        return f"{needed_n:.3g} N; possible"

    simulated, force, strain = PRINTED
    columns = (
        "error as",
        f"{simulated.text} ({1e3 * simulated.force_n:.3f} mN, simulation)",
        f"{force.text} (experiment)",
        f"{strain.text} ({1e3 * strain.force_n:.3f} mN, experiment)",
    )
    rows = [(unit.name, *(cell(unit, printed) for printed in PRINTED)) for unit in ERROR_UNITS]
    return Table("", columns, rows)


def _least_rates() -> Table:
    filter_hz = load_scene(find_scene("paper")).display.controller.derivative_filter_hz
    loops: dict[str, dict[str, Any]] = {
        "backward difference": {},
        f"filter N = {MATLAB_FILTER_RAD_PER_S:g} /s": {"filter_rad_per_s": MATLAB_FILTER_RAD_PER_S},
        f"filter of {filter_hz:g} Hz, as ours": {"filter_rad_per_s": 2 * math.pi * filter_hz},
        "backward difference, a delay of one sample": {"delay_ticks": 1},
    }
    rows = []
    for name, gains in GAINS.items():
        fastest = poles(FILM_MV, gains)[0]
        imaginary = f" ± {abs(fastest.imag):.0f}i" if fastest.imag else ""
        row = {
            "gains of the": name,
            "fastest poles, continuous": f"−{abs(fastest.real):.0f}{imaginary} /s",
        }
        for column, loop in loops.items():
            row[column] = f"{least_rate_hz(gains, **loop):.0f} Hz"
        rows.append(row)
    return Table.of("", rows)
