"""The first two chapters: the paper's figures beside ours, and contradictions inside the paper."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from protocol.config.scene_file import find_scene
from protocol.tactile import half_space_stress
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.document import Chapter, Plot, Table
from telepulse.paper import gain_units, published
from telepulse.paper.published import (
    ACTUATOR,
    CALIBRATION_FORCE_N,
    CALIBRATION_MV,
    CALIBRATION_MV_PER_N,
    EXPERIMENT,
    FILM_MV,
    FINGER_FILM,
    FIRST_S,
    LAYER,
    MEASURED_FORCE,
    MEASURED_STRAIN,
    SIMULATED_STRAIN,
    SIMULATION,
    STRAIN,
    WRIST_FILM,
    scientific,
)
from telepulse.paper.pulse_spectrum import SLOW_RESPIRATION_HZ, beats, deviation_n, spectra
from telepulse.paper.stepper import Floats, run_scene
from telepulse.scene import load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONVERTER_V = 10.0
# The error of the first beat, in which a simulation catches up from rest, is off the plot's scale.
BEAT_S = 0.8
# Strain over force of the experiment, both as forces by Table 3; they should be equal.
PRINTED_RATIO = MEASURED_STRAIN.force_n / MEASURED_FORCE.force_n
Rows = Sequence[tuple[str, ...]]


def chapter() -> Chapter:
    """Compute the paper's figures. Raises SceneError or SourceError."""
    scene = load_scene(find_scene("paper"))
    source = SyntheticScene.narrow(scene.sensing.source, f"{scene.path}: [sensing] source:")
    height_n, run = source.peak_to_peak_n, run_scene(scene)
    wanted_n = height_n * beats("paper", gain_units.RATE_HZ, FIRST_S)
    simulated_n = gain_units.follow(FILM_MV, SIMULATION, wanted_n)
    strain_rmse = gain_units.rmse(LAYER.strain(simulated_n - wanted_n))
    simulated_s = np.arange(len(wanted_n)) / gain_units.RATE_HZ
    paragraphs = (
        "Dargahi, Xie and Ji, “An experimental teletaction system for sensing and teleperception of"
        " human pulse”, Mechatronics 18 (2008) 195–207. Each of its figures that can be computed is"
        " computed here from its equations and tables, with the nodes' own models of film, layer,"
        " pulse and force loop.",
        "Every error depends on three things that the paper does not give: the pulse's height in"
        " newtons, the unit of the controller's error, and the recorded pulse itself."
        f" We chose a height of {height_n:g} N from peak to peak, an error in millivolts of the"
        " film by eq 21 (the only unit with which the gains follow a pulse, as “Five units for the"
        " gains” shows), and a synthetic pulse. No choice gives all three printed errors. Only the"
        " pulse's shape was fitted, to the five energy shares.",
    )
    plots = (
        Plot(
            "calibration",
            "Fig. 4: the film's voltage under a force, by eq 21 and as printed.",
            _draw_calibration,
        ),
        Plot(
            "simulated-strain",
            "Figs 13–14: the strain at the finger follows the wrist's, simulation's gains, error in"
            " mV by eq 21. The start from rest, at 0 s, is off the scale of the error.",
            lambda figure: _draw_tracking(figure, simulated_s, wanted_n, simulated_n, True),
        ),
        Plot(
            "force-tracking",
            "Figs 17–18: the felt force follows the pulse, experiment's gains on the display's own"
            " loop at 1 kHz (scene paper).",
            lambda figure: _draw_tracking(figure, run.t_s, run.wanted_n, run.felt_n, False),
        ),
        Plot(
            "strain-tracking",
            "Figs 19–20: the same run as strains by Table 3; compression is negative (eq 16).",
            lambda figure: _draw_tracking(figure, run.t_s, run.wanted_n, run.felt_n, True),
        ),
    )
    columns = ("figure", "paper", "ours", "why they differ")
    table = Table("Paper and ours", columns, _rows(strain_rmse, run.force_rmse_n, height_n))
    simulated_at_n = gain_units.height_n(FILM_MV, SIMULATED_STRAIN)
    energies = published.ENERGY_BELOW_HZ
    off = max(abs(spectra()["ours"].below(hz) - share) for hz, share in energies.items())
    findings = (
        f"Reproduced: the pulse's {len(energies)} energy shares (Fig. 16), within"
        f" {100 * off:.2f} percentage points, and the simulation's strain error (Figs 13–14), for"
        f" a pulse of {simulated_at_n:.3f} N, a height that the paper does not give.",
        "Not reproducible: the experiment's two errors (Figs 17–20). By Table 3, the printed strain"
        f" error is a force of {1e3 * MEASURED_STRAIN.force_n:.1f} mN, {PRINTED_RATIO:.2f} times"
        " the"
        f" printed force error of the same run, {1e3 * MEASURED_FORCE.force_n:.1f} mN.",
    )
    return Chapter("The paper beside this computation", paragraphs, (table,), plots, findings)


def _rows(strain_rmse: float, force_rmse_n: float, height_n: float) -> Rows:
    finger, wrist = (1e3 * film.volts_per_newton for film in (FINGER_FILM, WRIST_FILM))
    slope = CALIBRATION_MV_PER_N
    simulated_n, needed_n = (
        gain_units.height_n(FILM_MV, printed) for printed in (SIMULATED_STRAIN, MEASURED_FORCE)
    )
    from_rest_mn = 1e3 * gain_units.relative_rmse(FILM_MV, EXPERIMENT) * height_n
    return [
        (
            "Fig. 4, calibration of the film",
            f"about {slope:g} mV/N, {CALIBRATION_MV:g} mV at {CALIBRATION_FORCE_N} N",
            f"{finger:.0f} mV/N (r = 9 mm), {wrist:.0f} mV/N (8 mm)",
            f"Eq 21 with Table 1 gives {finger / slope:.0f} times the slope of Fig. 4. Eq 21 is a"
            " film's open-circuit voltage; a charge amplifier, whose gain is not printed, comes"
            " between. The line is straight in both.",
        ),
        (
            "Figs 13–14, strain RMSE of the simulation",
            SIMULATED_STRAIN.text,
            f"{scientific(strain_rmse, 4)} at {height_n:g} N",
            "An RMSE is proportional to the pulse's height, which the paper does not give. With"
            f" this unit the printed figure is that of a pulse of {simulated_n:.3f} N from peak to"
            " peak.",
        ),
        *_spectrum_rows(),
        (
            "Figs 17–18, force RMSE of the experiment",
            MEASURED_FORCE.text,
            f"{force_rmse_n:.6f} N at {height_n:g} N",
            "The experiment's gains on eq 22, as the display runs them at 1 kHz from a finger at"
            " rest on the preload; in continuous time, starting without force,"
            f" {from_rest_mn:.2f} mN. The printed error would need a pulse of {needed_n:.2f} N,"
            f" beyond the {CALIBRATION_FORCE_N} N of Fig. 4. More likely the experiment did not"
            " drive eq 22: a stepping motor has steps, a speed and a contact that eq 22 lacks.",
        ),
        (
            "Figs 19–20, strain RMSE of the experiment",
            MEASURED_STRAIN.text,
            f"{scientific(STRAIN.per_newton * force_rmse_n, 4)} at {height_n:g} N",
            f"By Table 3 the printed strain is {1e3 * MEASURED_STRAIN.force_n:.3f} mN and the"
            f" printed force is {1e3 * MEASURED_FORCE.force_n:.3f} mN, of one run. No loop can"
            f" cause this factor of {PRINTED_RATIO:.2f}, for the strain is the force times a"
            " constant. Our two figures are consistent.",
        ),
        (
            "Psychophysics",
            f"{published.SUBJECTS} subjects, {100 * published.FELT_CLOSE_TO_TOUCH:.0f} % felt it"
            " close to a direct touch",
            "–",
            "An experiment with people; it cannot be computed.",
        ),
    ]


def _spectrum_rows() -> Rows:
    shares = {name: spectrum.below for name, spectrum in spectra().items()}
    kept, removed = (shares[f"beats alone, mean {mean}"](0.4) for mean in ("kept", "removed"))
    reasons = {
        20.0: "Fitted: the narrowest wave of the beat sets the share above it.",
        10.0: "Fitted, by the widths of all three waves.",
        5.0: "Fitted. This share requires a sharp pulse: a wide radial pulse has"
        f" {100 * shares['wide'](5.0):.1f} %.",
        1.0: "Fitted, by respiration. The beat's own lowest line is at"
        f" {published.PULSE_PER_MIN / 60:g} Hz; its energy here has leaked through the window.",
        0.4: f"Fitted, by respiration at {SLOW_RESPIRATION_HZ:g} Hz and a small constant. It"
        f" depends on how the mean is treated: {100 * kept:.1f} % if it is kept,"
        f" {100 * removed:.2f} % if it is removed and there is no respiration.",
    }
    limit_hz, rate = published.SPECTRUM_TO_HZ, f"{published.PULSE_PER_MIN} beats/min"
    beyond = 1 - shares["ours"](limit_hz)
    pulse = (
        "Fig. 15, the pulse",
        f"{rate}, {limit_hz:g} Hz wide",
        f"{rate}, {100 * beyond:.4f} % of the energy above {limit_hz:g} Hz",
        "A synthetic pulse of three Gaussians a beat: the recorded one is not in print as numbers.",
    )
    return [pulse] + [
        (
            f"Fig. 16, energy below {hz:g} Hz",
            f"{100 * printed:.1f} %",
            f"{100 * shares['ours'](hz):.2f} %",
            reasons[hz],
        )
        for hz, printed in published.ENERGY_BELOW_HZ.items()
    ]


def _draw_calibration(figure: "Figure") -> None:
    axes = figure.subplots()
    force_n = np.array([0.01, CALIBRATION_FORCE_N])
    for film in (WRIST_FILM, FINGER_FILM):
        name = f"eq 21, r = {1e3 * film.radius_m:g} mm"
        axes.plot(force_n, 1e3 * (force_n * film.volts_per_newton), label=name)
    slope, end_mv = CALIBRATION_MV_PER_N, CALIBRATION_MV
    axes.plot(force_n, slope * force_n, label=f"Fig. 4, about {slope:g} mV/N")
    axes.plot(force_n[1], end_mv, "o", label="Fig. 4, end point as printed")
    axes.set(xscale="log", yscale="log", ylim=(0.1, 1e6))
    axes.set(xlabel="force in N", ylabel="film voltage in mV")
    axes.legend(loc="upper left", ncols=2)


def _draw_tracking(
    figure: "Figure", t_s: Floats, wanted: Floats, felt: Floats, as_strain: bool
) -> None:
    """Draw wanted and felt force or strain, and 1000 times their difference below."""
    quantity, error = "force in N", "error in mN"
    if as_strain:
        wanted, felt = (1e6 * LAYER.strain(force_n) for force_n in (wanted, felt))
        quantity, error = "strain in 10⁻⁶", "error in 10⁻⁹"
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    upper.plot(t_s, wanted, label="wanted", linewidth=3.5, alpha=0.6)
    upper.plot(t_s, felt, label="felt", linewidth=1.2)
    upper.set_ylabel(quantity)
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    difference = 1e3 * (felt - wanted)
    lower.plot(t_s, difference, linewidth=1.2, color="C2")
    reach = 1.15 * np.abs(difference[t_s > BEAT_S]).max()
    lower.set(ylim=(-reach, reach), xlim=(0, FIRST_S), xlabel="time in s", ylabel=error)
    figure.align_ylabels()


def contradictions() -> Chapter:
    """Compare layer, film and actuator with their own tables."""
    columns = ("what", "printed", "computed", "what follows")
    return Chapter(
        "Contradictions inside the paper",
        (
            "These rows need no controller, only the paper's tables and equations and, for two of"
            " them, the shape of a pulse.",
        ),
        (
            Table("Strain and force", columns, _layer_rows()),
            Table("Film and actuator", columns, _film_and_actuator_rows()),
        ),
    )


def _layer_rows() -> Rows:
    layer, per_newton, ratio = LAYER, STRAIN.per_newton, PRINTED_RATIO
    # Eq 16 goes with (1 − ν²) / (E d).
    poisson = math.sqrt(1 - (1 - layer.poisson_ratio**2) * ratio)
    _, stress_pa = half_space_stress(1.0, np.array([0.0]), np.array([layer.thickness_m]))
    modulus_mpa, thickness_mm = layer.young_modulus_pa / 1e6, 1e3 * layer.thickness_m
    return [
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
            "The chapter on the gains' units gives the pulse that this requires.",
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
            f"It should be the printed {MEASURED_STRAIN.text}, which is {ratio:.2f} times it. That"
            f" would take E = {modulus_mpa / ratio:.0f} MPa, d = {thickness_mm / ratio:.2f} mm or"
            f" ν = {poisson:.2f}; Table 3 has {modulus_mpa:.0f} MPa, {thickness_mm:g} mm and"
            f" {layer.poisson_ratio}, and no ν is above 0.5.",
        ),
        (
            "Stress on the axis (eqs 9–12)",
            "powers missing in eqs 9–10",
            f"σz = −{abs(float(stress_pa[0])):.1f} Pa under 1 N/m at {thickness_mm:g} mm",
            "The standard solution of a line load, which has the powers, gives the printed"
            " eqs 11–12; a misprint without consequence.",
        ),
    ]


def _film_and_actuator_rows() -> Rows:
    film, slope = FINGER_FILM, CALIBRATION_MV_PER_N
    film_mv = 1e3 * film.volts_per_newton
    thicknesses_m = (published.FILM_THICKNESS_M, published.ABSTRACT_FILM_THICKNESS_M)
    table_um, abstract_um = (1e6 * thickness_m for thickness_m in thicknesses_m)
    # The voltage under 1 N by eqs 2-4, step by step.
    stresses_pa = [1 / (2 * math.pi * film.radius_m * each_m) for each_m in thicknesses_m]
    thin, thick = (
        1e3 * ((film.g31 + film.g32) * stress_pa * thickness_m)
        for stress_pa, thickness_m in zip(stresses_pa, thicknesses_m, strict=True)
    )
    gain = WRIST_FILM.volts_per_newton / film.volts_per_newton
    mismatch = (gain - 1) * deviation_n("paper")
    # The voltage of eq 22 for the mean-free pulse of 1 N peak to peak.
    plant, step_s = ACTUATOR, 1 / gain_units.RATE_HZ
    force_n = beats("paper", gain_units.RATE_HZ, FIRST_S)
    rate = np.gradient(force_n, step_s)
    voltages = plant.m * np.gradient(rate, step_s) + plant.c * rate + plant.k * force_n
    # The differences are one-sided at the ends.
    volts = np.abs(voltages[2:-2]).max()
    return [
        (
            "Film's sensitivity",
            f"about {slope:g} mV/N (Fig. 4)",
            f"{film_mv:.0f} mV/N (eq 21)",
            f"A factor of {film_mv / slope:.0f}: the gains' “mV” has two possible meanings.",
        ),
        (
            "Radii of the films",
            "8 mm at the wrist, 9 mm at the finger",
            f"Fa = {gain:.3f} Fp where voltages are equal",
            "Matching voltages instead of forces or strains gives an RMSE of"
            f" {100 * mismatch:.1f} % of the pulse's height, however good the controller.",
        ),
        (
            "Film's thickness",
            f"{table_um:g} µm (Table 1), {abstract_um:g} µm (abstract)",
            f"{thin:.0f} and {thick:.0f} mV under 1 N",
            "The thickness cancels between eqs 2 and 4, so either may be true.",
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
        (
            "Natural frequency of eq 22",
            f"m = {plant.m} kg, c = {plant.c} N·s/m, k = {plant.k} N/m",
            f"{math.sqrt(plant.k / plant.m) / (2 * math.pi):.2f} Hz",
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
    ]
