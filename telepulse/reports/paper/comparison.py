"""The first chapter: every figure that can be computed, the paper's beside ours."""

from telepulse.reports.document import Chapter, Table
from telepulse.reports.paper import figures, numbers
from telepulse.reports.paper.notation import scientific
from telepulse.reports.paper.pulse import SLOW_RESPIRATION_HZ
from telepulse.reports.paper.readings import (
    MEASURED_FORCE,
    MEASURED_STRAIN,
    SIMULATED_STRAIN,
    STRAIN,
)
from telepulse.reports.paper.results import PaperResults


def chapter(results: PaperResults) -> Chapter:
    """Paper, ours and why they differ."""
    height = f"{results.height_n:g} N"
    return Chapter(
        "The paper beside this computation",
        (
            "Dargahi, Xie and Ji, “An experimental teletaction system for sensing and"
            " teleperception of human pulse”, Mechatronics 18 (2008) 195–207. Every figure of it"
            " that can be computed is computed here from its equations and tables, with the nodes'"
            " own models of film, layer, pulse and force loop.",
            "Three things that every error depends on are not in the paper: the pulse's height in"
            " newtons, the unit in which the controller saw its error, and the recorded pulse"
            f" itself. So three choices are ours: a height of {height} from peak to peak, an error"
            " in millivolts of the film by eq 21 (the only reading of the gains that follows a"
            " pulse, as “Five readings of the gains” shows), and a synthetic pulse. No choice"
            " gives all three printed errors, and none was made to: only the pulse's shape was"
            " fitted, to the five energy shares.",
        ),
        (Table("Paper and ours", ("figure", "paper", "ours", "why they differ"), _rows(results)),),
        (
            figures.calibration(),
            figures.simulated_strain(results.simulated.wanted_n, results.simulated.felt_n),
            figures.force_tracking(results.run),
            figures.strain_tracking(results.run),
        ),
    )


def _rows(results: PaperResults) -> tuple[tuple[str, ...], ...]:
    return (
        _calibration_row(),
        _simulation_row(results),
        *_spectrum_rows(results),
        _force_row(results),
        _strain_row(results),
        (
            "Psychophysics",
            f"{numbers.SUBJECTS} subjects, {100 * numbers.FELT_CLOSE_TO_TOUCH:.0f} % felt it close"
            " to a direct touch",
            "–",
            "It takes people; nothing here can compute it.",
        ),
    )


def _calibration_row() -> tuple[str, ...]:
    finger, wrist = (
        1e3 * film.volts_per_newton for film in (numbers.FINGER_FILM, numbers.WRIST_FILM)
    )
    return (
        "Fig. 4, calibration of the film",
        f"about {numbers.CALIBRATION_MV_PER_N:g} mV/N, {numbers.CALIBRATION_MV:g} mV at"
        f" {numbers.CALIBRATION_FORCE_N} N",
        f"{finger:.0f} mV/N (r = 9 mm), {wrist:.0f} mV/N (8 mm)",
        f"Eq 21 with Table 1 gives {finger / numbers.CALIBRATION_MV_PER_N:.0f} times the slope of"
        " Fig. 4. Eq 21 is a film's open-circuit voltage; a charge amplifier, whose gain we do"
        " not know, comes between. The line is straight in both.",
    )


def _simulation_row(results: PaperResults) -> tuple[str, ...]:
    needed_n = results.film_mv.peak_to_peak_n(SIMULATED_STRAIN)
    return (
        "Figs 13–14, strain RMSE of the simulation",
        SIMULATED_STRAIN.text,
        f"{scientific(results.simulated.strain_rmse, 4)} at {results.height_n:g} N",
        "An RMSE is as large as the pulse is high, and the paper gives no height. In this reading"
        f" the printed figure is that of a pulse of {needed_n:.3f} N from peak to peak.",
    )


def _spectrum_rows(results: PaperResults) -> tuple[tuple[str, ...], ...]:
    spectra = results.spectra

    def percent(share: float) -> str:
        return f"{100 * share:.1f} %"

    whys = {
        20.0: "Fitted: the narrowest wave of the beat sets what is left above.",
        10.0: "Fitted, by the widths of all three waves.",
        5.0: "Fitted. This is the share that asks for a sharp pulse: a wide radial pulse has"
        f" {percent(spectra.wide.below(5.0))}.",
        1.0: "Fitted, by respiration. The beat's own lowest line is at"
        f" {numbers.PULSE_PER_MIN / 60:g} Hz; what it has here"
        " has leaked through the window.",
        0.4: f"Fitted, by respiration at {SLOW_RESPIRATION_HZ:g} Hz and a small"
        " constant. It rests on what is done with the mean:"
        f" {percent(spectra.mean_kept.below(0.4))} if it is kept,"
        f" {100 * spectra.mean_removed.below(0.4):.2f} % if it is removed and nobody breathes.",
    }
    rows = [
        (
            f"Fig. 16, energy below {limit_hz:g} Hz",
            percent(printed),
            f"{100 * spectra.paper.below(limit_hz):.2f} %",
            whys[limit_hz],
        )
        for limit_hz, printed in numbers.ENERGY_BELOW_HZ.items()
    ]
    beyond = 1 - spectra.paper.below(numbers.SPECTRUM_TO_HZ)
    pulse = (
        "Fig. 15, the pulse",
        f"{numbers.PULSE_PER_MIN} beats/min, {numbers.SPECTRUM_TO_HZ:g} Hz wide",
        f"{numbers.PULSE_PER_MIN} beats/min, {100 * beyond:.4f} % of the energy above"
        f" {numbers.SPECTRUM_TO_HZ:g} Hz",
        "A synthetic pulse: the recorded one is not in print as numbers. Three Gaussians a beat.",
    )
    return (pulse, *rows)


def _force_row(results: PaperResults) -> tuple[str, ...]:
    film_mv = results.film_mv
    continuous_mn = 1e3 * film_mv.experiment * results.height_n
    needed_n = film_mv.peak_to_peak_n(MEASURED_FORCE)
    return (
        "Figs 17–18, force RMSE of the experiment",
        MEASURED_FORCE.text,
        f"{results.run.force_rmse_n:.6f} N at {results.height_n:g} N",
        "The experiment's gains on eq 22, as the display runs them at 1 kHz from a finger at"
        f" rest on the preload; in continuous time from no force at all, {continuous_mn:.2f} mN."
        f" The printed error would take a pulse of {needed_n:.2f} N, beyond the"
        f" {numbers.CALIBRATION_FORCE_N} N of Fig. 4. More likely eq 22 is not what was driven: a"
        " stepping motor has steps, a speed and a contact that eq 22 leaves out.",
    )


def _strain_row(results: PaperResults) -> tuple[str, ...]:
    ratio = MEASURED_STRAIN.force_n / MEASURED_FORCE.force_n
    return (
        "Figs 19–20, strain RMSE of the experiment",
        MEASURED_STRAIN.text,
        f"{scientific(STRAIN.per_newton * results.run.force_rmse_n, 4)} at {results.height_n:g} N",
        f"By Table 3 the printed strain is {1e3 * MEASURED_STRAIN.force_n:.3f} mN and the printed"
        f" force is {1e3 * MEASURED_FORCE.force_n:.3f} mN, of one run: a factor of {ratio:.2f}"
        " inside the paper that no loop can make, for the strain is the force times a constant."
        " Ours follow from each other.",
    )
