"""The third chapter: what the gains act on, taken apart."""

import math

from display_node.scene import DisplayScene
from telepulse.reports.document import Chapter, Table
from telepulse.reports.paper import figures, numbers, readings
from telepulse.reports.paper.notation import scientific
from telepulse.reports.paper.numbers import Gains
from telepulse.reports.paper.readings import (
    FILM_MV,
    MEASURED_FORCE,
    MEASURED_STRAIN,
    PRINTED,
    SIMULATED_STRAIN,
    Printed,
    ReadingOutcome,
)
from telepulse.reports.paper.results import PaperResults
from telepulse.reports.paper.sampling import least_rate_hz, spectral_radius

# A loop is called following when its error is below this share of doing nothing's.
FOLLOWING = 0.5
MATLAB_FILTER_RAD_PER_S = 100.0


def chapter(results: PaperResults) -> Chapter:
    """Five readings, what each makes of the printed errors, and how fast it must run."""
    return Chapter(
        "Five readings of the gains",
        (_method(), *_why_none(results), _start(results)),
        (_errors(results), _heights(results), _rates(results.scene.display)),
        (figures.five_readings(results.outcomes, results.doing_nothing),),
    )


def _method() -> str:
    return (
        "Table 5 gives gains without units. The controller may have seen its error as strain, in"
        " newtons, in volts of the film by eq 21, in millivolts by Fig. 4 or in millivolts by eq"
        f" 21: an error of 1 N is from {scientific(readings.STRAIN.per_newton, 1)} to"
        f" {FILM_MV.per_newton:.0f} to it."
        " Each is closed here over eq 22 in continuous time with a pure derivative. The reference"
        " is the paper's pulse without its mean, straight between samples at"
        f" {readings.RATE_HZ / 1000:g} kHz, for the first {numbers.FIRST_S:g} s from rest; the"
        " error is a mean over time by trapezoids."
    )


def _start(results: PaperResults) -> str:
    film_mv = results.film_mv
    settled = readings.rmse_without_the_start(FILM_MV, numbers.SIMULATION)
    return (
        "In the reading that follows, the start matters: the pulse does not begin at zero, and"
        f" catching up is part of the first {numbers.FIRST_S:g} s. Begun on the pulse, the"
        f" simulation's error is {settled:.5f} of the height instead of {film_mv.simulation:.5f}."
    )


def _why_none(results: PaperResults) -> tuple[str, ...]:
    shares = [outcome.simulation / outcome.experiment for outcome in results.outcomes]
    force_over_strain = MEASURED_FORCE.force_n / MEASURED_STRAIN.force_n
    film_mv = results.film_mv
    sim_n = film_mv.peak_to_peak_n(SIMULATED_STRAIN)
    return (
        "No reading gives all three figures. Every error is proportional to the pulse's height,"
        " which is not printed, so every reading gives any one of them at some height. But the"
        " experiment's force and strain are two views of one error, in a fixed ratio by Table 3,"
        f" and the printed pair is off that ratio by a factor of {force_over_strain:.2f}: whatever"
        " the controller saw, its two heights differ by that factor. Leaving one of the pair out"
        " does not help: the printed error of the simulation is"
        f" {SIMULATED_STRAIN.force_n / MEASURED_STRAIN.force_n:.3f} of the experiment's by the"
        f" strain and {SIMULATED_STRAIN.force_n / MEASURED_FORCE.force_n:.3f} by the force, while"
        f" the readings have it between {min(shares):.2f} and {max(shares):.2f}.",
        "Taken one at a time: a printed error can come from a reading that follows the pulse, as"
        " Figs 13–14 and 17–20 show it followed, at a height inside the film's calibration."
        f" Only millivolts by eq 21 follow; the other four leave more than"
        f" half the error of doing nothing. {SIMULATED_STRAIN.text} is such an error, of a pulse"
        f" of {sim_n:.3f} N; the experiment's gains would then leave"
        f" {1e3 * sim_n * film_mv.experiment:.1f} mN, not"
        f" {1e3 * MEASURED_FORCE.force_n:.1f}. {MEASURED_STRAIN.text} can be of a pulse of"
        f" {film_mv.peak_to_peak_n(MEASURED_STRAIN):.2f} N. {MEASURED_FORCE.text} would take"
        f" {film_mv.peak_to_peak_n(MEASURED_FORCE):.2f} N, more than the film was calibrated to:"
        " no reading accounts for it. An experiment's error also has in it what eq 22 has not:"
        " steps, noise, friction and the delay of the computer.",
    )


def _errors(results: PaperResults) -> Table:
    rows = [
        (
            outcome.reading.name,
            _size(outcome.reading.per_newton),
            f"{outcome.simulation:.3g}",
            f"{outcome.experiment:.3g}",
            _follows(outcome, results.doing_nothing),
        )
        for outcome in results.outcomes
    ]
    nothing = (
        "doing nothing",
        "–",
        *2 * (f"{results.doing_nothing:.3f}",),
        f"over whole beats; {results.doing_nothing_first_s:.3f} over the first"
        f" {numbers.FIRST_S:g} s, which end amid a beat",
    )
    return Table(
        "RMSE over peak to peak",
        ("error as", "seen of 1 N", "simulation's gains", "experiment's gains", "does it follow?"),
        (*rows, nothing),
        "Following is taken to mean less than half the error of doing nothing. Strain is too"
        " small a signal to move the actuator; newtons, volts and the millivolts of"
        " Fig. 4 move it, but at a resonance amid the pulse's own frequencies.",
    )


def _size(per_newton: float) -> str:
    return f"{per_newton:.4g}" if per_newton >= 1 else scientific(per_newton, 4)


def _follows(outcome: ReadingOutcome, doing_nothing: float) -> str:
    marks = [
        _does_follow(error, doing_nothing) for error in (outcome.simulation, outcome.experiment)
    ]
    if all(marks):
        return "yes"
    if outcome.simulation < doing_nothing:
        return "no; simulation's gains are a little better than nothing"
    return "no"


def _does_follow(error: float, doing_nothing: float) -> bool:
    return error < FOLLOWING * doing_nothing


def _heights(results: PaperResults) -> Table:
    rows = tuple(
        (
            outcome.reading.name,
            *(_height(outcome, printed, results.doing_nothing) for printed in PRINTED),
        )
        for outcome in results.outcomes
    )
    return Table(
        "The pulse's height at which a reading gives a printed figure, and whether it can be so",
        (
            "error as",
            f"{SIMULATED_STRAIN.text} ({1e3 * SIMULATED_STRAIN.force_n:.3f} mN, simulation)",
            f"{MEASURED_FORCE.text} (experiment)",
            f"{MEASURED_STRAIN.text} ({1e3 * MEASURED_STRAIN.force_n:.3f} mN, experiment)",
        ),
        rows,
        "A row would need one height in all three columns.",
    )


def _height(outcome: ReadingOutcome, printed: Printed, doing_nothing: float) -> str:
    height_n = outcome.peak_to_peak_n(printed)
    if not _does_follow(outcome.under(printed.gains), doing_nothing):
        return f"{1e3 * height_n:.1f} mN; no, does not follow"
    if height_n > numbers.CALIBRATION_FORCE_N:
        return f"{height_n:.3g} N; no, beyond Fig. 4's {numbers.CALIBRATION_FORCE_N} N"
    return f"{height_n:.3g} N; can be"


def _rates(display: DisplayScene) -> Table:
    filter_hz, rate_hz = display.controller.derivative_filter_hz, 1e9 / display.tick_ns
    return Table(
        "How fast the loop must be sampled, error in mV by eq 21",
        (
            "gains of the",
            "fastest poles, continuous",
            "backward difference",
            f"filter N = {MATLAB_FILTER_RAD_PER_S:g} /s",
            f"filter of {filter_hz:g} Hz, as ours",
            "backward difference, one more sample of delay",
        ),
        (
            _rate_row("simulation", numbers.SIMULATION, filter_hz),
            _rate_row("experiment", numbers.EXPERIMENT, filter_hz),
        ),
        "The least rate at which the sampled loop's largest pole is inside the unit circle: eq 22"
        " by the exact zero-order hold, integral and derivative (and its filter) by backward"
        f" Euler. At {rate_hz / 1000:g} kHz the simulation's gains are unstable (largest pole"
        f" {spectral_radius(rate_hz, numbers.SIMULATION):.2f}), so Figs 13–14 cannot be run on"
        " a loop of that rate. The experiment's are stable with a pure difference, but not with"
        " one more sample of delay (largest pole"
        f" {spectral_radius(rate_hz, numbers.EXPERIMENT, delay_ticks=1):.4f}).",
    )


def _rate_row(name: str, gains: Gains, filter_hz: float) -> tuple[str, ...]:
    fastest = readings.poles(FILM_MV, gains)[0]
    pole = f"−{abs(fastest.real):.0f}"
    if fastest.imag:
        pole += f" ± {abs(fastest.imag):.0f}i"
    return (
        name,
        f"{pole} /s",
        f"{least_rate_hz(gains):.0f} Hz",
        f"{least_rate_hz(gains, MATLAB_FILTER_RAD_PER_S):.0f} Hz",
        f"{least_rate_hz(gains, 2 * math.pi * filter_hz):.0f} Hz",
        f"{least_rate_hz(gains, delay_ticks=1):.0f} Hz",
    )
