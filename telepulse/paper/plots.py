"""The plots of `telepulse paper`; their captions are in `page.md`."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from telepulse.document import Plot, text_colour
from telepulse.paper.comparison import Comparison
from telepulse.paper.gain_units import Floats, relative_rmse
from telepulse.paper.published import (
    CALIBRATION_FORCE_N,
    CALIBRATION_MV,
    CALIBRATION_MV_PER_N,
    ENERGY_BELOW_HZ,
    ERROR_UNITS,
    FINGER_FILM,
    FIRST_S,
    GAINS,
    LAYER,
    MEASURED_FORCE,
    PRINTED,
    SPECTRUM_TO_HZ,
    WRIST_FILM,
)
from telepulse.paper.pulse_spectrum import RATE_HZ, beats, deviation_n, spectra
from telepulse.paper.stability import NO_FILTER_HZ, RateResult
from telepulse.paper.stepper import TrackingRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The error of the first beat, in which a simulation catches up from rest, is off the plot's scale.
BEAT_S = 0.8
SHOWN_S = (3.0, 4.8)
# Of two panels below each other.
TALL_INCHES = (5.2, 6.4)


def plots(
    ours: Comparison, on_film: TrackingRun, shipped: TrackingRun, rates: list[RateResult]
) -> dict[str, Plot]:
    """Return all plots. on_film, shipped: of the real bench."""
    drawn: dict[str, Callable[[Figure], None]] = {
        "calibration": _calibration,
        "simulated-strain": lambda figure: _tracking(figure, ours.simulation, as_strain=True),
        "force-tracking": lambda figure: _tracking(figure, ours.experiment),
        "strain-tracking": lambda figure: _tracking(figure, ours.experiment, as_strain=True),
        "readings": _readings,
        "pulse": _pulse,
        "spectrum": _spectrum,
        "real-bench": lambda figure: _real_bench(figure, on_film, shipped),
        "stability": lambda figure: _rates(figure, rates),
    }
    return {name: Plot(name, "", draw) for name, draw in drawn.items()}


def _calibration(figure: "Figure") -> None:
    axes = figure.subplots()
    force_n = np.array([0.01, CALIBRATION_FORCE_N])
    for film in (WRIST_FILM, FINGER_FILM):
        name = f"eq 21, r = {1e3 * film.radius_m:g} mm"
        axes.plot(force_n, 1e3 * (force_n * film.volts_per_newton), label=name)
    slope = CALIBRATION_MV_PER_N
    axes.plot(
        force_n, slope * force_n, label=f"Fig. 4 of Dargahi et al. (2008), about {slope:g} mV/N"
    )
    axes.plot(force_n[1], CALIBRATION_MV, "o", label="its end point, as printed")
    axes.set(xscale="log", yscale="log", ylim=(0.1, 1e7))
    axes.set(xlabel="force in N", ylabel="film voltage in mV")
    axes.legend(loc="upper left")


def _tracking(figure: "Figure", run: TrackingRun, as_strain: bool = False) -> None:
    """Draw wanted and felt force or strain, and 1000 times their difference below."""
    wanted, felt = run.wanted_n, run.felt_n
    quantity, error = "force in N", "error in mN"
    if as_strain:
        wanted, felt = (1e6 * LAYER.strain(force_n) for force_n in (wanted, felt))
        quantity, error = "strain in 10⁻⁶", "error in 10⁻⁹"
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    upper.plot(run.t_s, wanted, label="wanted", linewidth=3.5, alpha=0.6)
    upper.plot(run.t_s, felt, label="felt", linewidth=1.2)
    upper.set_ylabel(quantity)
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    difference = 1e3 * (felt - wanted)
    lower.plot(run.t_s, difference, linewidth=1.2, color="C2")
    reach = 1.15 * np.abs(difference[run.t_s > BEAT_S]).max()
    lower.set(ylim=(-reach, reach), xlim=(0, FIRST_S), xlabel="time in s", ylabel=error)
    figure.align_ylabels()


def _readings(figure: "Figure") -> None:
    """Draw RMSE over peak to peak against the pulse's height, with the printed figures' lines."""
    figure.set_size_inches(TALL_INCHES)
    heights_n, level = np.array([2e-3, 10.0]), 0.03
    panels = figure.subplots(2, 1, sharex=True)
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
        axes.set(ylabel="RMSE over peak to peak", title=f"gains of the {name}")
    panels[1].set_xlabel("pulse, N peak to peak")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="small")


def _pulse(figure: "Figure") -> None:
    axes = figure.subplots()
    force_n = beats("paper", RATE_HZ, FIRST_S, slow_parts=True)
    axes.plot(np.arange(len(force_n)) / RATE_HZ, force_n)
    axes.set(xlabel="time in s", ylabel="force over the height of a beat", xlim=(0, FIRST_S))


def _spectrum(figure: "Figure") -> None:
    paper = spectra()["ours"]
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot(paper.frequency_hz, paper.density)
    upper.set(yscale="log", ylim=(1e-9, 1), ylabel="density in 1/Hz")
    lower.plot(paper.frequency_hz, 100 * paper.shares(), drawstyle="steps-post", label="ours")
    limits_hz, shares = zip(*ENERGY_BELOW_HZ.items(), strict=True)
    printed = 100 * np.array(shares)
    lower.plot(limits_hz, printed, "o", color=text_colour(), label="paper, as printed")
    lower.legend(loc="lower right")
    lower.set(ylabel="energy below in %", xlabel="frequency in Hz", xlim=(0, SPECTRUM_TO_HZ))


def _real_bench(figure: "Figure", on_film: TrackingRun, shipped: TrackingRun) -> None:
    force, error = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    shown = (shipped.t_s >= SHOWN_S[0]) & (shipped.t_s < SHOWN_S[1])

    def cut(values: Floats) -> Floats:
        return values[shown]

    t_s = cut(shipped.t_s)
    force.plot(t_s, cut(shipped.wanted_n), label="wanted")
    force.plot(t_s, cut(on_film.felt_n), label="on the film's reading")
    force.plot(t_s, cut(shipped.felt_n), "--", label="as shipped")
    force.set(ylabel="force in N", ylim=(0.2, 0.7))
    figure.legend(*force.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    for number, run in enumerate((on_film, shipped), 1):
        error.plot(t_s, 1e3 * cut(run.felt_n - run.wanted_n), color=f"C{number}")
    error.set(xlabel="time in s", ylabel="error in mN")
    figure.align_ylabels()


def _rates(figure: "Figure", rates: list[RateResult]) -> None:
    figure.set_size_inches(TALL_INCHES)
    poles, errors = figure.subplots(2, 1, sharex=True)
    for colour, name in enumerate(GAINS):
        own = [each for each in rates if (each.gains, each.filter_hz) == (name, NO_FILTER_HZ)]
        rate_hz = [each.rate_hz for each in own]
        shipped: dict[str, Any] = {"color": f"C{colour}", "linewidth": 5.0, "alpha": 0.5}
        explicit: dict[str, Any] = {"color": f"C{colour}", "linewidth": 1.2, "marker": "o"}
        explicit["linestyle"] = "--"
        for loop, style in (("shipped", shipped), ("explicit", explicit)):
            radius = [getattr(each, f"{loop}_radius") for each in own]
            poles.plot(rate_hz, radius, label=f"{name}, {loop}", **style)
            errors.plot(rate_hz, [1e3 * getattr(each, f"{loop}_n") for each in own], **style)
    for axes in (poles, errors):
        axes.set(xscale="log", yscale="log")
    poles.set_ylabel("largest pole")
    errors.set(xlabel="tick rate in Hz", ylabel="force RMSE in mN", ylim=(0.1, 10))
    figure.legend(*poles.get_legend_handles_labels(), loc="outside lower center", ncols=2)
