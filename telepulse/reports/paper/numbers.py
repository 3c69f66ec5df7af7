"""What the paper prints: Dargahi, Xie and Ji, Mechatronics 18 (2008) 195-207.

Nothing here is ours, except where a comment says how a misprint is read.
"""

from dataclasses import dataclass

from display_node.plant.second_order import SecondOrderScene
from protocol.tactile import ElasticLayer, Film


@dataclass(frozen=True, slots=True)
class Gains:
    """PID gains as Table 5 prints them; the table gives no units."""

    kp: float
    ki: float
    kd: float


# Table 1, with g32 = g31: its "2 pC/N" for g32 has the unit of a charge coefficient.
WRIST_FILM = Film(radius_m=8e-3)
FINGER_FILM = Film(radius_m=9e-3)
FILM_THICKNESS_M = 2.5e-6
ABSTRACT_FILM_THICKNESS_M = 25e-6
LAYER = ElasticLayer(young_modulus_pa=0.05e9, thickness_m=2e-3, poisson_ratio=0.5)
"""Table 3, the same at both sides. Its figures take N as N/m: a contact length of 1 m."""
ACTUATOR = SecondOrderScene(kind="second_order", m=0.65, c=0.61, k=4.23)
"""Table 4 and eq 22."""
SIMULATION = Gains(13, 0.85, 0.5)
"""Table 5, simulation."""
EXPERIMENT = Gains(15, 0.15, 0.03)
"""Table 5, experiment."""
PULSE_PER_MIN = 75

# Fig. 4: a straight line to about 110 mV at 2.5 N; its slope is read off as about 45 mV/N.
CALIBRATION_FORCE_N = 2.5
CALIBRATION_MV = 110.0
CALIBRATION_MV_PER_N = 45.0

# From the pulse's Welch spectrum (Fig. 16): share of the energy below a frequency.
ENERGY_BELOW_HZ = {20.0: 0.997, 10.0: 0.894, 5.0: 0.574, 1.0: 0.124, 0.4: 0.048}
SPECTRUM_TO_HZ = 40.0

# Results, eqs 23-25 over the first 6 s.
FIRST_S = 6.0
SIMULATION_STRAIN_RMSE = 9.4249e-9
EXPERIMENT_FORCE_RMSE_N = 0.020863
EXPERIMENT_STRAIN_RMSE = 5.7802e-8
SUBJECTS = 6
FELT_CLOSE_TO_TOUCH = 0.66
