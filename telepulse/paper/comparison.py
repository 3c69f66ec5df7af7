"""The paper's simulation and experiment computed again, and contradictions between its tables."""

import math
from dataclasses import dataclass

import numpy as np

from protocol.config.scene_file import find_scene
from protocol.tactile import half_space_stress
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.paper import gain_units
from telepulse.paper.gain_units import Floats
from telepulse.paper.published import (
    ACTUATOR,
    CALIBRATION_MV_PER_N,
    FILM_MV,
    FINGER_FILM,
    FIRST_S,
    LAYER,
    MEASURED_FORCE,
    MEASURED_STRAIN,
    SIMULATION,
    WRIST_FILM,
)
from telepulse.paper.pulse_spectrum import beats, deviation_n
from telepulse.paper.stepper import TrackingRun, run_scene
from telepulse.scene import load_scene

# Range of a usual converter.
CONVERTER_V = 10.0
# Strain over force of the experiment, both as forces by Table 3; they should be equal.
PRINTED_RATIO = MEASURED_STRAIN.force_n / MEASURED_FORCE.force_n


@dataclass(frozen=True, slots=True)
class Comparison:
    """Our runs of the paper's simulation and experiment.

    height_n: of the pulse from peak to peak, as the scene `paper` has it. simulation: in continuous
    time, from rest. experiment: on the display's own loop at 1 kHz.
    """

    height_n: float
    simulation: TrackingRun
    experiment: TrackingRun

    @property
    def strain_rmse(self) -> float:
        """Strain RMSE of the simulation (Figs 13-14)."""
        error_n = self.simulation.felt_n - self.simulation.wanted_n
        return gain_units.rmse(LAYER.strain(error_n))


def compare() -> Comparison:
    """Run the paper's loop at our pulse's height. Raises SceneError or SourceError."""
    scene = load_scene(find_scene("paper"))
    source = SyntheticScene.narrow(scene.sensing.source, f"{scene.path}: [sensing] source:")
    wanted_n = source.peak_to_peak_n * beats("paper", gain_units.RATE_HZ, FIRST_S)
    felt_n = gain_units.follow(FILM_MV, SIMULATION, wanted_n)
    t_s: Floats = np.arange(len(wanted_n)) / gain_units.RATE_HZ
    return Comparison(source.peak_to_peak_n, TrackingRun(t_s, wanted_n, felt_n), run_scene(scene))


def needed_poisson_ratio() -> float:
    """Return the Poisson's ratio at which both printed errors of the experiment agree."""
    # Eq 16 goes with (1 − ν²) / (E d).
    return math.sqrt(1 - (1 - LAYER.poisson_ratio**2) * PRINTED_RATIO)


def axial_stress_pa() -> float:
    """Return the stress of eqs 9-12 on the axis below 1 N/m, at the layer's depth."""
    _, stress_pa = half_space_stress(1.0, np.array([0.0]), np.array([LAYER.thickness_m]))
    return float(stress_pa[0])


def film_mv_per_n(thickness_m: float) -> float:
    """Return the finger film's voltage under 1 N by eqs 2-4, step by step, in mV."""
    film = FINGER_FILM
    stress_pa = 1 / (2 * math.pi * film.radius_m * thickness_m)
    return 1e3 * ((film.g31 + film.g32) * stress_pa * thickness_m)


def film_factor() -> float:
    """Return the film's sensitivity by eq 21 over that of Fig. 4."""
    return 1e3 * FINGER_FILM.volts_per_newton / CALIBRATION_MV_PER_N


def radii_force_gain() -> float:
    """Return the force at the finger over that at the wrist where the films' voltages are equal."""
    return WRIST_FILM.volts_per_newton / FINGER_FILM.volts_per_newton


def radii_error() -> float:
    """Return the RMSE over peak to peak that matching voltages instead of forces makes."""
    return (radii_force_gain() - 1) * deviation_n("paper")


def natural_frequency_hz() -> float:
    """Return the natural frequency of eq 22."""
    return math.sqrt(ACTUATOR.k / ACTUATOR.m) / (2 * math.pi)


def volts_per_newton() -> float:
    """Return the largest voltage of eq 22 for the pulse of 1 N peak to peak without its mean."""
    step_s = 1 / gain_units.RATE_HZ
    force_n = beats("paper", gain_units.RATE_HZ, FIRST_S)
    rate = np.gradient(force_n, step_s)
    voltages = ACTUATOR.m * np.gradient(rate, step_s) + ACTUATOR.c * rate + ACTUATOR.k * force_n
    # The differences are one-sided at the ends.
    return float(np.abs(voltages[2:-2]).max())
