"""The first chapter: each figure of the paper that can be computed, the paper's beside ours."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from protocol.config.scene_file import find_scene
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.reports.document import Chapter, Plot, Table
from telepulse.reports.paper import experiment, gain_units, published
from telepulse.reports.paper.experiment import Floats, TrackingRun, draw_tracking
from telepulse.reports.paper.gain_units import film_millivolts
from telepulse.reports.paper.published import (
    FILM_MV,
    MEASURED_FORCE,
    MEASURED_STRAIN,
    SIMULATED_STRAIN,
    STRAIN,
    scientific,
)
from telepulse.reports.paper.pulse_spectrum import SLOW_RESPIRATION_HZ, beats, spectra
from telepulse.scene import load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENE = "paper"


def chapter() -> Chapter:
    """Compute the paper's figures. Raises SceneError or SourceError."""
    scene = load_scene(find_scene(SCENE))
    source = scene.sensing.source
    assert isinstance(source, SyntheticScene), "scenes/paper.toml names a synthetic pulse"
    height_n, run = source.peak_to_peak_n, experiment.run(scene)
    wanted_n = height_n * beats("paper", gain_units.RATE_HZ, published.FIRST_S)
    simulated_n = gain_units.follow(FILM_MV, published.SIMULATION, wanted_n)
    rows = (
        _calibration_row(),
        _simulation_row(gain_units.rmse(published.LAYER.strain(simulated_n - wanted_n)), height_n),
        *_spectrum_rows(),
        _force_row(run.force_rmse_n, height_n),
        _strain_row(run.force_rmse_n, height_n),
        (
            "Psychophysics",
            f"{published.SUBJECTS} subjects, {100 * published.FELT_CLOSE_TO_TOUCH:.0f} % felt it"
            " close to a direct touch",
            "–",
            "Needs people; nothing here can compute it.",
        ),
    )
    return Chapter(
        "The paper beside this computation",
        (
            "Dargahi, Xie and Ji, “An experimental teletaction system for sensing and"
            " teleperception of human pulse”, Mechatronics 18 (2008) 195–207. Every figure of it"
            " that can be computed is computed here from its equations and tables, with the nodes'"
            " own models of film, layer, pulse and force loop.",
            "Every error depends on three things that the paper does not give: the pulse's height"
            " in newtons, the unit in which the controller saw its error, and the recorded pulse"
            f" itself. We chose a height of {height_n:g} N from peak to peak, an error in"
            " millivolts of the film by eq 21 (the only unit with which the gains follow a pulse,"
            " as “Five units for the gains” shows), and a synthetic pulse. No choice gives all"
            " three printed errors. Only the pulse's shape was fitted, to the five energy shares.",
        ),
        (Table("Paper and ours", ("figure", "paper", "ours", "why they differ"), rows),),
        (_calibration_plot(), _simulation_plot(wanted_n, simulated_n), *_experiment_plots(run)),
    )


def _calibration_row() -> tuple[str, ...]:
    finger, wrist = (
        1e3 * film.volts_per_newton for film in (published.FINGER_FILM, published.WRIST_FILM)
    )
    return (
        "Fig. 4, calibration of the film",
        f"about {published.CALIBRATION_MV_PER_N:g} mV/N, {published.CALIBRATION_MV:g} mV at"
        f" {published.CALIBRATION_FORCE_N} N",
        f"{finger:.0f} mV/N (r = 9 mm), {wrist:.0f} mV/N (8 mm)",
        f"Eq 21 with Table 1 gives {finger / published.CALIBRATION_MV_PER_N:.0f} times the slope"
        " of Fig. 4. Eq 21 is a film's open-circuit voltage; a charge amplifier, whose gain is not"
        " printed, comes between. The line is straight in both.",
    )


def _simulation_row(strain_rmse: float, height_n: float) -> tuple[str, ...]:
    needed_n = film_millivolts().peak_to_peak_n(SIMULATED_STRAIN)
    return (
        "Figs 13–14, strain RMSE of the simulation",
        SIMULATED_STRAIN.text,
        f"{scientific(strain_rmse, 4)} at {height_n:g} N",
        "An RMSE is proportional to the pulse's height, which the paper does not give. With this"
        f" unit the printed figure is that of a pulse of {needed_n:.3f} N from peak to peak.",
    )


def _spectrum_rows() -> tuple[tuple[str, ...], ...]:
    paper, mean_kept, mean_removed, wide = spectra()
    reasons = {
        20.0: "Fitted: the narrowest wave of the beat sets the share above it.",
        10.0: "Fitted, by the widths of all three waves.",
        5.0: "Fitted. This share requires a sharp pulse: a wide radial pulse has"
        f" {100 * wide.below(5.0):.1f} %.",
        1.0: "Fitted, by respiration. The beat's own lowest line is at"
        f" {published.PULSE_PER_MIN / 60:g} Hz; its energy here has leaked through the window.",
        0.4: f"Fitted, by respiration at {SLOW_RESPIRATION_HZ:g} Hz and a small constant. It"
        f" depends on how the mean is treated: {100 * mean_kept.below(0.4):.1f} % if it is kept,"
        f" {100 * mean_removed.below(0.4):.2f} % if it is removed and there is no respiration.",
    }
    shares = [
        (
            f"Fig. 16, energy below {limit_hz:g} Hz",
            f"{100 * printed:.1f} %",
            f"{100 * paper.below(limit_hz):.2f} %",
            reasons[limit_hz],
        )
        for limit_hz, printed in published.ENERGY_BELOW_HZ.items()
    ]
    beyond = 1 - paper.below(published.SPECTRUM_TO_HZ)
    pulse = (
        "Fig. 15, the pulse",
        f"{published.PULSE_PER_MIN} beats/min, {published.SPECTRUM_TO_HZ:g} Hz wide",
        f"{published.PULSE_PER_MIN} beats/min, {100 * beyond:.4f} % of the energy above"
        f" {published.SPECTRUM_TO_HZ:g} Hz",
        "A synthetic pulse of three Gaussians a beat: the recorded one is not in print as numbers.",
    )
    return (pulse, *shares)


def _force_row(force_rmse_n: float, height_n: float) -> tuple[str, ...]:
    continuous_mn = 1e3 * film_millivolts().experiment * height_n
    needed_n = film_millivolts().peak_to_peak_n(MEASURED_FORCE)
    return (
        "Figs 17–18, force RMSE of the experiment",
        MEASURED_FORCE.text,
        f"{force_rmse_n:.6f} N at {height_n:g} N",
        "The experiment's gains on eq 22, as the display runs them at 1 kHz from a finger at"
        f" rest on the preload; in continuous time, starting without force, {continuous_mn:.2f} mN."
        f" The printed error would need a pulse of {needed_n:.2f} N, beyond the"
        f" {published.CALIBRATION_FORCE_N} N of Fig. 4. More likely eq 22 is not what was driven:"
        " a stepping motor has steps, a speed and a contact that eq 22 leaves out.",
    )


def _strain_row(force_rmse_n: float, height_n: float) -> tuple[str, ...]:
    ratio = MEASURED_STRAIN.force_n / MEASURED_FORCE.force_n
    return (
        "Figs 19–20, strain RMSE of the experiment",
        MEASURED_STRAIN.text,
        f"{scientific(STRAIN.per_newton * force_rmse_n, 4)} at {height_n:g} N",
        f"By Table 3 the printed strain is {1e3 * MEASURED_STRAIN.force_n:.3f} mN and the printed"
        f" force is {1e3 * MEASURED_FORCE.force_n:.3f} mN, of one run. No loop can cause this"
        f" factor of {ratio:.2f}, for the strain is the force times a constant. Our two figures"
        " are consistent.",
    )


def _calibration_plot() -> Plot:
    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        force_n = np.array([0.01, published.CALIBRATION_FORCE_N])
        for film in (published.WRIST_FILM, published.FINGER_FILM):
            name = f"eq 21, r = {1e3 * film.radius_m:g} mm"
            axes.plot(force_n, 1e3 * film.volts(force_n), label=name)
        fig_4 = f"Fig. 4, about {published.CALIBRATION_MV_PER_N:g} mV/N"
        axes.plot(force_n, published.CALIBRATION_MV_PER_N * force_n, label=fig_4)
        end = published.CALIBRATION_FORCE_N, published.CALIBRATION_MV
        axes.plot(*end, "o", label="Fig. 4, end point as printed")
        axes.set(xscale="log", yscale="log", ylim=(0.1, 1e6))
        axes.set(xlabel="force in N", ylabel="film voltage in mV")
        axes.legend(loc="upper left", ncols=2)

    caption = "Fig. 4: the film's voltage under a force, by eq 21 and as printed."
    return Plot("calibration", caption, draw)


def _simulation_plot(wanted_n: Floats, felt_n: Floats) -> Plot:
    t_s = np.arange(len(wanted_n)) / gain_units.RATE_HZ
    return Plot(
        "simulated-strain",
        "Figs 13-14: the strain at the finger follows the wrist's, simulation's gains, error in"
        " mV by eq 21. The start from rest, at 0 s, is off the scale of the error.",
        _draw_strain(t_s, wanted_n, felt_n),
    )


def _experiment_plots(run: TrackingRun) -> tuple[Plot, Plot]:
    force = draw_tracking(run.t_s, run.wanted_n, run.felt_n, "force in N", "error in mN")
    return (
        Plot(
            "force-tracking",
            "Figs 17-18: the felt force follows the pulse, experiment's gains on the display's own"
            " loop at 1 kHz (scenes/paper.toml).",
            force,
        ),
        Plot(
            "strain-tracking",
            "Figs 19-20: the same run as strains by Table 3; compression is negative (eq 16).",
            _draw_strain(run.t_s, run.wanted_n, run.felt_n),
        ),
    )


def _draw_strain(t_s: Floats, wanted_n: Floats, felt_n: Floats) -> "Callable[[Figure], None]":
    wanted, felt = (1e6 * published.LAYER.strain(force_n) for force_n in (wanted_n, felt_n))
    return draw_tracking(t_s, wanted, felt, "strain in 10⁻⁶", "error in 10⁻⁹")
