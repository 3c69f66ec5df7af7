"""Values that the paper publishes, and possible units of its controller's error.

Dargahi, Xie and Ji, Mechatronics 18 (2008) 195-207. A comment marks each misprint and how it is
interpreted here; everything else is as printed.
"""

from typing import NamedTuple

from display_node.plant.scene import SecondOrderScene
from protocol.tactile import ElasticLayer, Film


class Gains(NamedTuple):
    """PID gains as Table 5 prints them; the table gives no units."""

    kp: float
    ki: float
    kd: float


# Table 1, with g32 = g31: its "2 pC/N" for g32 has the unit of a charge coefficient.
WRIST_FILM = Film(radius_m=8e-3)
FINGER_FILM = Film(radius_m=9e-3)
PRINTED_G32 = "2 pC/N"
FILM_THICKNESS_M = 2.5e-6
ABSTRACT_FILM_THICKNESS_M = 25e-6
LAYER = ElasticLayer(young_modulus_pa=0.05e9, thickness_m=2e-3, poisson_ratio=0.5)
"""Table 3, the same at both sides. Its figures take N as N/m: a contact length of 1 m."""
ACTUATOR = SecondOrderScene(kind="second_order", m=0.65, c=0.61, k=4.23)
"""Table 4 and eq 22."""
SIMULATION = Gains(13, 0.85, 0.5)
EXPERIMENT = Gains(15, 0.15, 0.03)
GAINS = {"simulation": SIMULATION, "experiment": EXPERIMENT}
"""Table 5."""
PULSE_PER_MIN = 75

# Fig. 4: a straight line to about 110 mV at 2.5 N, whose slope is about 45 mV/N.
CALIBRATION_FORCE_N = 2.5
CALIBRATION_MV = 110.0
CALIBRATION_MV_PER_N = 45.0

# From the pulse's Welch spectrum (Fig. 16): share of the energy below a frequency.
ENERGY_BELOW_HZ = {20.0: 0.997, 10.0: 0.894, 5.0: 0.574, 1.0: 0.124, 0.4: 0.048}
SPECTRUM_TO_HZ = 40.0

# Results over the first 6 s; the printed RMSEs (eqs 23-25) are at the end of this file.
FIRST_S = 6.0
SUBJECTS = 6
FELT_CLOSE_TO_TOUCH = 0.66


class ErrorUnit(NamedTuple):
    """A possible unit of the controller's error, and the value of 1 N in it."""

    name: str
    per_newton: float


STRAIN = ErrorUnit("strain", abs(LAYER.strain_per_newton))
NEWTONS = ErrorUnit("N", 1.0)
VOLTS = ErrorUnit("V by eq 21", FINGER_FILM.volts_per_newton)
CALIBRATED_MV = ErrorUnit("mV by Fig. 4", CALIBRATION_MV_PER_N)
FILM_MV = ErrorUnit("mV by eq 21", 1e3 * FINGER_FILM.volts_per_newton)
ERROR_UNITS = (STRAIN, NEWTONS, VOLTS, CALIBRATED_MV, FILM_MV)


def scientific(value: float, digits: int) -> str:
    """Return a small number as the paper writes it: 9.4249e-9, without a zero in the exponent."""
    mantissa, exponent = f"{value:.{digits}e}".split("e")
    return f"{mantissa}e{int(exponent)}"


class PrintedRmse(NamedTuple):
    """An RMSE as printed, the gains it belongs to, and the same as a force by Table 3."""

    text: str
    gains: Gains
    force_n: float


def _strain_rmse(strain: float, gains: Gains) -> PrintedRmse:
    return PrintedRmse(scientific(strain, 4), gains, strain / STRAIN.per_newton)


SIMULATED_STRAIN = _strain_rmse(9.4249e-9, SIMULATION)
MEASURED_FORCE = PrintedRmse("0.020863 N", EXPERIMENT, 0.020863)
MEASURED_STRAIN = _strain_rmse(5.7802e-8, EXPERIMENT)
PRINTED = (SIMULATED_STRAIN, MEASURED_FORCE, MEASURED_STRAIN)
