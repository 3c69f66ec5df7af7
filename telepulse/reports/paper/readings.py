"""Table 5's gains have no units: five readings of what the PID saw, each closed over eq 22.

In continuous time, with a pure derivative, so that nothing but the reading makes a difference.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter, residue

from telepulse.reports.paper import numbers
from telepulse.reports.paper.notation import scientific
from telepulse.reports.paper.numbers import Gains
from telepulse.reports.paper.pulse import beats

# Fine enough for the fastest pole, at −4056 /s.
RATE_HZ = 50_000.0


@dataclass(frozen=True, slots=True)
class UnitReading:
    """What the controller sees of an error of 1 N."""

    name: str
    per_newton: float


STRAIN = UnitReading("strain", abs(numbers.LAYER.strain_per_newton))
NEWTONS = UnitReading("N", 1.0)
VOLTS = UnitReading("V by eq 21", numbers.FINGER_FILM.volts_per_newton)
CALIBRATED_MV = UnitReading("mV by Fig. 4", numbers.CALIBRATION_MV_PER_N)
FILM_MV = UnitReading("mV by eq 21", 1e3 * numbers.FINGER_FILM.volts_per_newton)
READINGS = (STRAIN, NEWTONS, VOLTS, CALIBRATED_MV, FILM_MV)


@dataclass(frozen=True, slots=True)
class Printed:
    """An RMSE as printed, and the force error it stands for by Table 3."""

    text: str
    gains: Gains
    force_n: float


SIMULATED_STRAIN = Printed(
    scientific(numbers.SIMULATION_STRAIN_RMSE, 4),
    numbers.SIMULATION,
    numbers.SIMULATION_STRAIN_RMSE / STRAIN.per_newton,
)
MEASURED_FORCE = Printed(
    f"{numbers.EXPERIMENT_FORCE_RMSE_N} N", numbers.EXPERIMENT, numbers.EXPERIMENT_FORCE_RMSE_N
)
MEASURED_STRAIN = Printed(
    scientific(numbers.EXPERIMENT_STRAIN_RMSE, 4),
    numbers.EXPERIMENT,
    numbers.EXPERIMENT_STRAIN_RMSE / STRAIN.per_newton,
)
PRINTED = (SIMULATED_STRAIN, MEASURED_FORCE, MEASURED_STRAIN)


def closed_loop(
    reading: UnitReading, gains: Gains
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """From wanted to felt force, as polynomials in s: the PID on the read error, over eq 22."""
    plant = numbers.ACTUATOR
    opened = reading.per_newton * np.array([gains.kd, gains.kp, gains.ki])
    own = np.array([plant.m, plant.c, plant.k, 0.0])
    return opened, np.polyadd(own, opened)


def poles(reading: UnitReading, gains: Gains) -> NDArray[np.complex128]:
    """Poles of the closed loop in 1/s, the fastest first."""
    found = np.roots(closed_loop(reading, gains)[1]).astype(np.complex128)
    return found[np.argsort(-np.abs(found))]


def follow(
    reading: UnitReading, gains: Gains, wanted_n: NDArray[np.float64], rate_hz: float = RATE_HZ
) -> NDArray[np.float64]:
    """Felt force in N from rest, shape as wanted_n, which is drawn straight between samples.

    Exact at the samples: the loop's partial fractions, each with its own first-order response
    to straight lines (as scipy's lsim, which takes a hundred times as long).
    """
    step_s = 1 / rate_hz
    felt_n = np.zeros(len(wanted_n), np.complex128)
    weights, own_rates, _ = residue(*closed_loop(reading, gains))
    for weight, own_rate in zip(weights, own_rates, strict=True):
        held = expm(step_s * np.array([[own_rate, 1, 0], [0, 0, 1], [0, 0, 0]]))
        kept, level, slope = held[0, 0], weight * held[0, 1], weight * held[0, 2] / step_s
        at_rest = np.array([-slope * wanted_n[0]])
        felt_n += lfilter([slope, level - slope], [1, -kept], wanted_n, zi=at_rest)[0]
    return felt_n.real


def rmse(error: NDArray[np.float64]) -> float:
    """Root of the mean square in time (eqs 23-25), the square by trapezoids."""
    return math.sqrt(float(np.trapezoid(error**2)) / (len(error) - 1))


@dataclass(frozen=True, slots=True)
class ReadingOutcome:
    """RMSE over peak to peak of the paper's pulse in its first 6 s, under a reading."""

    reading: UnitReading
    simulation: float
    experiment: float

    def under(self, gains: Gains) -> float:
        """RMSE over peak to peak with these gains of Table 5."""
        return self.simulation if gains == numbers.SIMULATION else self.experiment

    def peak_to_peak_n(self, printed: Printed) -> float:
        """The pulse's height in N at which this reading gives the printed figure."""
        return printed.force_n / self.under(printed.gains)


def measure() -> tuple[ReadingOutcome, ...]:
    """The outcome of every reading."""
    wanted_n = beats("paper", RATE_HZ, numbers.FIRST_S)

    def error(reading: UnitReading, gains: Gains) -> float:
        return rmse(follow(reading, gains, wanted_n) - wanted_n)

    return tuple(
        ReadingOutcome(
            reading, error(reading, numbers.SIMULATION), error(reading, numbers.EXPERIMENT)
        )
        for reading in READINGS
    )


def rmse_without_the_start(reading: UnitReading, gains: Gains) -> float:
    """As an outcome's, of a loop that starts on the pulse instead of at rest."""
    wanted_n = beats("paper", RATE_HZ, numbers.FIRST_S)
    moved_n = wanted_n - wanted_n[0]
    return rmse(follow(reading, gains, moved_n) - moved_n)


def volts_for_one_newton() -> float:
    """Largest voltage that eq 22 needs for the mean-free pulse of 1 N peak to peak."""
    plant, step_s = numbers.ACTUATOR, 1 / RATE_HZ
    force_n = beats("paper", RATE_HZ, numbers.FIRST_S)
    rate = np.gradient(force_n, step_s)
    volts = plant.m * np.gradient(rate, step_s) + plant.c * rate + plant.k * force_n
    # The differences are one-sided at the ends.
    return float(np.abs(volts[2:-2]).max())


def natural_frequency_hz() -> float:
    """Of eq 22, undamped."""
    return math.sqrt(numbers.ACTUATOR.k / numbers.ACTUATOR.m) / (2 * math.pi)
