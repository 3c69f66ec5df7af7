"""The second chapter: contradictions inside the paper, computed from its own numbers."""

import math

import numpy as np

from protocol.tactile import Film, half_space_stress
from telepulse.reports.document import Chapter, Table
from telepulse.reports.paper import published
from telepulse.reports.paper.gain_units import RATE_HZ
from telepulse.reports.paper.published import (
    MEASURED_FORCE,
    MEASURED_STRAIN,
    SIMULATED_STRAIN,
    STRAIN,
    scientific,
)
from telepulse.reports.paper.pulse_spectrum import beats, deviation_n

CONVERTER_V = 10.0
COLUMNS = ("what", "printed", "computed", "what follows")


def volts_for_one_newton() -> float:
    """Return the largest voltage that eq 22 needs for the mean-free pulse of 1 N peak to peak."""
    plant, step_s = published.ACTUATOR, 1 / RATE_HZ
    force_n = beats("paper", RATE_HZ, published.FIRST_S)
    rate = np.gradient(force_n, step_s)
    volts = plant.m * np.gradient(rate, step_s) + plant.c * rate + plant.k * force_n
    # The differences are one-sided at the ends.
    return float(np.abs(volts[2:-2]).max())


def natural_frequency_hz() -> float:
    """Return the undamped natural frequency of eq 22 in Hz."""
    return math.sqrt(published.ACTUATOR.k / published.ACTUATOR.m) / (2 * math.pi)


def chapter() -> Chapter:
    """Compare layer, film and actuator with their own tables."""
    return Chapter(
        "Contradictions inside the paper",
        (
            "These rows need no controller, only the paper's tables and equations and, for two of"
            " them, the shape of a pulse.",
        ),
        (
            Table("Strain and force", COLUMNS, _layer_rows()),
            Table("Film and actuator", COLUMNS, (*_film_rows(), *_actuator_rows())),
        ),
    )


def _layer_rows() -> tuple[tuple[str, ...], ...]:
    layer, per_newton = published.LAYER, STRAIN.per_newton
    implied = published.EXPERIMENT_STRAIN_RMSE / published.EXPERIMENT_FORCE_RMSE_N
    ratio = implied / per_newton
    # Eq 16 goes with (1 − ν²) / (E d).
    poisson = math.sqrt(1 - (1 - layer.poisson_ratio**2) * ratio)
    _, stress_pa = half_space_stress(1.0, np.array([0.0]), np.array([layer.thickness_m]))
    return (
        (
            "Strain of 1 N (eq 16, Table 3)",
            "–",
            scientific(per_newton, 4),
            "Eq 9 has a load per length: N is taken as N/m, so a contact"
            f" {layer.contact_length_m:g} m long is implied.",
        ),
        (
            "Simulation's strain RMSE as a force",
            SIMULATED_STRAIN.text,
            f"{1e3 * SIMULATED_STRAIN.force_n:.3f} mN",
            "The chapter on the gains' units gives the pulse it would need.",
        ),
        (
            "Experiment's strain RMSE as a force",
            MEASURED_STRAIN.text,
            f"{1e3 * MEASURED_STRAIN.force_n:.3f} mN",
            f"It should be the printed {MEASURED_FORCE.text}.",
        ),
        (
            "Experiment's force RMSE as a strain",
            MEASURED_FORCE.text,
            scientific(per_newton * MEASURED_FORCE.force_n, 3),
            f"It should be the printed {MEASURED_STRAIN.text}, which is {ratio:.2f} of it. That"
            f" would take E = {layer.young_modulus_pa / ratio / 1e6:.0f} MPa,"
            f" d = {1e3 * layer.thickness_m / ratio:.2f} mm or ν = {poisson:.2f};"
            f" Table 3 has {layer.young_modulus_pa / 1e6:.0f} MPa,"
            f" {1e3 * layer.thickness_m:g} mm and {layer.poisson_ratio}, and no ν is above 0.5.",
        ),
        (
            "Stress on the axis (eqs 9–12)",
            "powers missing in eqs 9–10",
            f"σz = −{abs(float(stress_pa[0])):.1f} Pa under 1 N/m at"
            f" {1e3 * layer.thickness_m:g} mm",
            "The standard solution of a line load, which has the powers, gives the printed"
            " eqs 11–12; a misprint without consequence.",
        ),
    )


def _film_rows() -> tuple[tuple[str, ...], ...]:
    film = published.FINGER_FILM
    thin, thick = (
        1e3 * _volts_through_stress(film, thickness_m)
        for thickness_m in (published.FILM_THICKNESS_M, published.ABSTRACT_FILM_THICKNESS_M)
    )
    gain = published.FINGER_FILM.newtons(published.WRIST_FILM.volts(1.0))
    mismatch = (gain - 1) * deviation_n("paper")
    return (
        (
            "Film's sensitivity",
            f"about {published.CALIBRATION_MV_PER_N:g} mV/N (Fig. 4)",
            f"{1e3 * film.volts_per_newton:.0f} mV/N (eq 21)",
            f"A factor of {1e3 * film.volts_per_newton / published.CALIBRATION_MV_PER_N:.0f}: “mV"
            "” has two meanings for the gains.",
        ),
        (
            "Radii r_pv of the films",
            "8 mm at the wrist, 9 mm at the finger",
            f"Fa = {gain:.3f} Fp where voltages are equal",
            "Matching voltages instead of forces or strains gives an RMSE of"
            f" {100 * mismatch:.1f} % of the pulse's height, however good the controller.",
        ),
        (
            "Film's thickness",
            f"{1e6 * published.FILM_THICKNESS_M:g} µm (Table 1),"
            f" {1e6 * published.ABSTRACT_FILM_THICKNESS_M:g} µm (abstract)",
            f"{thin:.0f} and {thick:.0f} mV under 1 N",
            "It cancels between eqs 2 and 4: either may be true.",
        ),
        (
            "g32 (Table 1)",
            "2 pC/N",
            f"taken as g31, {film.g31} V·m/N",
            "The unit is a charge coefficient's, so the value is one too. Eq 2 requires a biaxial"
            " film, whose two coefficients are equal.",
        ),
        (
            "Static force",
            "–",
            "errors of the pulse without its mean",
            "A PVDF film with a charge amplifier blocks a constant: a hold-down force can be set"
            " but not measured.",
        ),
    )


def _actuator_rows() -> tuple[tuple[str, ...], ...]:
    volts = volts_for_one_newton()
    return (
        (
            "Natural frequency of eq 22",
            f"m = {published.ACTUATOR.m} kg, c = {published.ACTUATOR.c} N·s/m,"
            f" k = {published.ACTUATOR.k} N/m",
            f"{natural_frequency_hz():.2f} Hz",
            "Eq 22 turns a voltage into a force, so kg and N/m cannot be its units; and the"
            " pulse's energy is above that frequency. It is kept as the paper's model.",
        ),
        (
            "Voltage for a pulse of 1 N through eq 22",
            "–",
            f"{volts:.0f} V at the peak",
            f"A converter of ±{CONVERTER_V:g} V, as is usual, would follow a pulse of"
            f" {1e3 * CONVERTER_V / volts:.1f} mN from peak to peak. We leave the voltage"
            " unbounded.",
        ),
    )


def _volts_through_stress(film: Film, thickness_m: float) -> float:
    """Return the voltage under 1 N by eqs 2-4, step by step."""
    stress_pa = 1 / (2 * math.pi * film.radius_m * thickness_m)
    return (film.g31 + film.g32) * stress_pa * thickness_m
