"""Five units for the gains of Table 5, which gives none, each in a loop with the actuator of eq 22.

The loops are in continuous time with a pure derivative, so that only the unit makes a difference.
"""

import math
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter, residue

from protocol.config.scene_file import find_scene
from telepulse.document import Chapter, Plot, Table, text_colour
from telepulse.paper import published
from telepulse.paper.explicit_loop import least_rate_hz, spectral_radius
from telepulse.paper.published import (
    ERROR_UNITS,
    EXPERIMENT,
    FILM_MV,
    FIRST_S,
    GAINS,
    MEASURED_FORCE,
    MEASURED_STRAIN,
    PRINTED,
    SIMULATED_STRAIN,
    SIMULATION,
    ErrorUnit,
    Gains,
    PrintedRmse,
    scientific,
)
from telepulse.paper.pulse_spectrum import beats, deviation_n
from telepulse.scene import load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def chapter() -> Chapter:
    """Compare the errors of each unit with the printed ones; give the least sampling rate."""
    shares = [
        relative_rmse(unit, SIMULATION) / relative_rmse(unit, EXPERIMENT) for unit in ERROR_UNITS
    ]
    simulated_n = height_n(FILM_MV, SIMULATED_STRAIN)
    left_mn = 1e3 * simulated_n * relative_rmse(FILM_MV, EXPERIMENT)
    paragraphs = (
        "Table 5 gives gains without units. The controller's error may have been a strain, or in"
        " newtons, in volts of the film by eq 21, in millivolts by Fig. 4 or in millivolts by eq"
        f" 21: an error of 1 N has a size from {scientific(published.STRAIN.per_newton, 1)} to"
        f" {FILM_MV.per_newton:.0f}. Here each loop is closed over eq 22 in continuous time with a"
        " pure derivative. The reference is the paper's pulse without its mean, straight between"
        f" samples at {RATE_HZ / 1000:g} kHz, for the first {FIRST_S:g} s from rest; the error is a"
        " mean over time by trapezoids.",
        "The paper prints an error of the simulation, a strain, and two of the experiment, a force"
        " and a strain. No unit gives all three. Every error is proportional to the pulse's height,"
        " which is not printed, so every unit gives any one of them at some height. But the"
        " experiment's force and strain are two views of one error, in a fixed ratio by Table 3,"
        " and the printed pair is off that ratio by a factor of"
        f" {MEASURED_FORCE.force_n / MEASURED_STRAIN.force_n:.2f}: with any unit, the heights that"
        " give the one and the other differ by that factor. Leaving one of the pair out does not"
        " help. The simulation's printed error is"
        f" {SIMULATED_STRAIN.force_n / MEASURED_STRAIN.force_n:.3f} times the experiment's strain"
        f" and {SIMULATED_STRAIN.force_n / MEASURED_FORCE.force_n:.3f} times its force; the five"
        f" units give ratios from {min(shares):.2f} to {max(shares):.2f}.",
        "Taken one at a time: a printed error is possible if the loop follows the pulse, as Figs"
        " 13–14 and 17–20 show, at a height inside the film's calibration. Only with millivolts by"
        " eq 21 does it follow; with the other four, more than half the error of doing nothing is"
        f" left. {SIMULATED_STRAIN.text} is such an error, of a pulse of {simulated_n:.3f} N; the"
        f" experiment's gains would then leave {left_mn:.1f} mN, not"
        f" {1e3 * MEASURED_FORCE.force_n:.1f}. {MEASURED_STRAIN.text} is possible for a pulse of"
        f" {height_n(FILM_MV, MEASURED_STRAIN):.2f} N. {MEASURED_FORCE.text} would need"
        f" {height_n(FILM_MV, MEASURED_FORCE):.2f} N, more than the film was calibrated to: no unit"
        " explains it. An experiment's error also contains what eq 22 leaves out: steps, noise,"
        " friction and the delay of the computer.",
        "Where the loop follows, the start matters: the pulse does not begin at zero, and catching"
        f" up is part of the first {FIRST_S:g} s. Begun on the pulse, the simulation's error is"
        f" {relative_rmse(FILM_MV, SIMULATION, from_rest=False):.5f} of the height instead of"
        f" {relative_rmse(FILM_MV, SIMULATION):.5f}.",
    )
    caption = (
        "Each unit's error (level lines) and each printed figure (falling lines). Where they"
        " cross, that unit gives that figure; the right panel's two figures are of one run,"
        " yet no unit meets both at one height."
    )
    tables, plot = (
        (_errors_table(), _heights_table(), _rates_table()),
        Plot("readings", caption, _draw),
    )
    follow_it = [unit.name for unit in ERROR_UNITS if follows(unit)]
    finding = (
        f"Of {len(ERROR_UNITS)} possible units of the controller's error, the printed gains follow"
        f" the pulse only with {' and '.join(follow_it) or 'none'}."
    )
    return Chapter("Five units for the gains", paragraphs, tables, (plot,), (finding,))


def follows(unit: ErrorUnit) -> bool:
    """Return whether both gain sets leave less than half of the error of doing nothing."""
    worst = max(relative_rmse(unit, gains) for gains in GAINS.values())
    return worst < FOLLOWING * deviation_n("paper")


def _errors_table() -> Table:
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
    note = (
        "Following means less than half the error of doing nothing. Strain is too small a signal"
        " to move the actuator; newtons, volts and the millivolts of Fig. 4 move it, but with a"
        " resonance among the pulse's own frequencies."
    )
    return Table("RMSE over peak to peak", (*columns, "does it follow?"), rows, note)


def _heights_table() -> Table:
    def cell(unit: ErrorUnit, printed: PrintedRmse) -> str:
        needed_n = height_n(unit, printed)
        if relative_rmse(unit, printed.gains) >= FOLLOWING * deviation_n("paper"):
            return f"{1e3 * needed_n:.1f} mN; no, does not follow"
        if needed_n > published.CALIBRATION_FORCE_N:
            return f"{needed_n:.3g} N; no, beyond Fig. 4's {published.CALIBRATION_FORCE_N} N"
        return f"{needed_n:.3g} N; possible"

    columns = (
        "error as",
        f"{SIMULATED_STRAIN.text} ({1e3 * SIMULATED_STRAIN.force_n:.3f} mN, simulation)",
        f"{MEASURED_FORCE.text} (experiment)",
        f"{MEASURED_STRAIN.text} ({1e3 * MEASURED_STRAIN.force_n:.3f} mN, experiment)",
    )
    return Table(
        "The pulse's height at which a unit gives a printed figure, and whether that is possible",
        columns,
        [(unit.name, *(cell(unit, printed) for printed in PRINTED)) for unit in ERROR_UNITS],
        "A unit explains all three where its row has the same height in all columns.",
    )


def _rates_table() -> Table:
    display = load_scene(find_scene("paper")).display
    filter_hz, rate_hz = display.controller.derivative_filter_hz, 1e9 / display.tick_ns
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
    return Table.of(
        "Least sampling rate of the loop, error in mV by eq 21",
        rows,
        "The lowest rate at which the sampled loop's largest pole is inside the unit circle: eq 22"
        " by the exact zero-order hold, integral and derivative (and its filter) by backward"
        f" Euler. At {rate_hz / 1000:g} kHz the simulation's gains are unstable (largest pole"
        f" {spectral_radius(rate_hz, SIMULATION):.2f}), so Figs 13–14 cannot be run on"
        " a loop of that rate. The experiment's are stable with a pure difference, but not with"
        " one more sample of delay (largest pole"
        f" {spectral_radius(rate_hz, EXPERIMENT, delay_ticks=1):.4f}).",
    )


def _draw(figure: "Figure") -> None:
    """Draw RMSE over peak to peak against the pulse's height, with the printed figures' lines."""
    heights_n, level = np.array([2e-3, 10.0]), 0.03
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (name, gains) in zip(panels, GAINS.items(), strict=True):
        nothing = deviation_n("paper")
        axes.axhline(nothing, ls=":", color=text_colour(), zorder=3, label="doing nothing")
        for unit in ERROR_UNITS:
            axes.plot(heights_n, 2 * [relative_rmse(unit, gains)], label=unit.name)
        for printed in (each for each in PRINTED if each.gains == gains):
            share = printed.force_n / heights_n
            axes.plot(heights_n, share, "--", color=text_colour(), linewidth=1.2)
            right = printed == MEASURED_FORCE
            axes.annotate(
                printed.text,
                (printed.force_n / level, level),
                xytext=(6 if right else -6, 0),
                textcoords="offset points",
                ha="left" if right else "right",
                va="bottom" if right else "top",
                fontsize="small",
            )
        axes.set(xscale="log", yscale="log", xlim=heights_n, ylim=(1e-3, 1))
        axes.set(xlabel="pulse, N peak to peak", title=f"gains of the {name}")
    panels[0].set_ylabel("RMSE over peak to peak")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
