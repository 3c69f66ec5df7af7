"""The report's plots: the paper's Figs 4 and 13 to 20, and two of ours."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from telepulse.reports.document import Plot
from telepulse.reports.paper import numbers, readings
from telepulse.reports.paper.experiment import ExperimentRun
from telepulse.reports.paper.pulse import beats, beats_with_slow_parts
from telepulse.reports.paper.readings import Printed, ReadingOutcome
from telepulse.reports.paper.spectrum import RATE_HZ, Spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN_S = 6.0
BEAT_S = 0.8
AMPLITUDES_N = np.array([2e-3, 10.0])


def calibration() -> Plot:
    """Fig. 4 against eq 21."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        force_n = np.array([0.01, numbers.CALIBRATION_FORCE_N])
        for film in (numbers.WRIST_FILM, numbers.FINGER_FILM):
            name = f"eq 21, r = {1e3 * film.radius_m:g} mm"
            axes.plot(force_n, 1e3 * film.volts(force_n), label=name)
        fig_4 = f"Fig. 4, about {numbers.CALIBRATION_MV_PER_N:g} mV/N"
        axes.plot(force_n, numbers.CALIBRATION_MV_PER_N * force_n, label=fig_4)
        end = numbers.CALIBRATION_FORCE_N, numbers.CALIBRATION_MV
        axes.plot(*end, "o", label="Fig. 4, end point as printed")
        axes.set(xscale="log", yscale="log", ylim=(0.1, 1e6))
        axes.set(xlabel="force in N", ylabel="film voltage in mV")
        axes.legend(loc="upper left", ncols=2)

    return Plot(
        "calibration", "Fig. 4: the film's voltage under a force, by eq 21 and as read.", draw
    )


def simulated_strain(wanted_n: NDArray[np.float64], felt_n: NDArray[np.float64]) -> Plot:
    """Figs 13-14: strains at both sides and their difference, in continuous time."""
    t_s = np.arange(len(wanted_n)) / readings.RATE_HZ
    wanted, felt = numbers.LAYER.strain(wanted_n), numbers.LAYER.strain(felt_n)
    return Plot(
        "simulated-strain",
        "Figs 13-14: the strain at the finger follows the wrist's, simulation's gains, error in"
        " mV by eq 21. The start from rest, at 0 s, is off the scale of the error.",
        _tracking(t_s, 1e6 * wanted, 1e6 * felt, ("strain in 10⁻⁶", "error in 10⁻⁹")),
    )


def force_tracking(run: ExperimentRun) -> Plot:
    """Figs 17-18."""
    return Plot(
        "force-tracking",
        "Figs 17-18: the felt force follows the pulse, experiment's gains on the display's own"
        " loop at 1 kHz (scenes/paper.toml).",
        _tracking(run.t_s, run.wanted_n, run.felt_n, ("force in N", "error in mN")),
    )


def strain_tracking(run: ExperimentRun) -> Plot:
    """Figs 19-20."""
    wanted, felt = numbers.LAYER.strain(run.wanted_n), numbers.LAYER.strain(run.felt_n)
    return Plot(
        "strain-tracking",
        "Figs 19-20: the same run as strains by Table 3; compression is negative (eq 16).",
        _tracking(run.t_s, 1e6 * wanted, 1e6 * felt, ("strain in 10⁻⁶", "error in 10⁻⁹")),
    )


def pulse() -> Plot:
    """Fig. 15."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        force_n = beats_with_slow_parts("paper", RATE_HZ, SHOWN_S)
        axes.plot(np.arange(len(force_n)) / RATE_HZ, force_n)
        axes.set(xlabel="time in s", ylabel="force in N, beats of 1 N", xlim=(0, SHOWN_S))

    return Plot(
        "pulse",
        "Fig. 15: the synthetic pulse at 75 beats/min with its respiration; the height is a unit"
        " here, for the paper gives none in newtons.",
        draw,
    )


def spectrum(paper: Spectrum) -> Plot:
    """Fig. 16, as density and as energy below a frequency."""

    def draw(figure: "Figure") -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        upper.plot(paper.frequency_hz, paper.density)
        upper.set(yscale="log", ylim=(1e-9, 1), ylabel="density in N²/Hz")
        _shares(lower, paper, "-", "ours")
        _printed_shares(lower)
        lower.set(
            ylabel="energy below in %", xlabel="frequency in Hz", xlim=(0, numbers.SPECTRUM_TO_HZ)
        )
        lower.legend(loc="lower right")

    return Plot("spectrum", "Fig. 16: Welch spectrum of the pulse, and the energy below.", draw)


def presets(paper: Spectrum, wide: Spectrum) -> Plot:
    """One beat of both pulses, and the energy below a frequency of each."""

    def draw(figure: "Figure") -> None:
        left, right = figure.subplots(1, 2)
        for name, style, spectrum in (("paper", "-", paper), ("wide", "--", wide)):
            force_n = beats("paper" if name == "paper" else "wide", RATE_HZ, BEAT_S)
            left.plot(1e3 * np.arange(len(force_n)) / RATE_HZ, force_n, style, label=name)
            _shares(right, spectrum, style, name)
        left.set(xlabel="time in ms", ylabel="force in N, beats of 1 N")
        left.legend(loc="upper right")
        _printed_shares(right)
        right.set(
            xlabel="frequency in Hz",
            ylabel="energy below in %",
            xscale="log",
            xlim=(0.3, numbers.SPECTRUM_TO_HZ),
        )
        limits_hz = list(numbers.ENERGY_BELOW_HZ)
        right.set_xticks(limits_hz, [f"{limit_hz:g}" for limit_hz in limits_hz])
        right.set_xticks([], minor=True)
        right.legend(loc="lower right")

    return Plot("presets", "A beat of both pulses, and the energy below a frequency.", draw)


def five_readings(outcomes: tuple[ReadingOutcome, ...], doing_nothing: float) -> Plot:
    """RMSE over peak to peak against the pulse's height, with the printed figures' lines."""

    def draw(figure: "Figure") -> None:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, gains, name in (
            (panels[0], numbers.SIMULATION, "simulation"),
            (panels[1], numbers.EXPERIMENT, "experiment"),
        ):
            axes.axhline(doing_nothing, ls=":", color=_ink(), zorder=3, label="doing nothing")
            for outcome in outcomes:
                ratio = outcome.under(gains)
                axes.plot(AMPLITUDES_N, [ratio, ratio], label=outcome.reading.name)
            for printed in readings.PRINTED:
                if printed.gains == gains:
                    _printed_line(axes, printed)
            axes.set(xscale="log", yscale="log", xlim=AMPLITUDES_N, ylim=(1e-3, 1))
            axes.set(xlabel="pulse, N peak to peak", title=f"gains of the {name}")
        panels[0].set_ylabel("RMSE over peak to peak")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)

    return Plot(
        "readings",
        "Each reading's error (level lines) and each printed figure (falling lines). Where they"
        " cross, that reading gives that figure; the right panel's two figures are of one run,"
        " yet no reading meets both at one height.",
        draw,
    )


def _tracking(
    t_s: NDArray[np.float64],
    wanted: NDArray[np.float64],
    felt: NDArray[np.float64],
    labels: tuple[str, str],
) -> "Callable[[Figure], None]":
    def draw(figure: "Figure") -> None:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        upper.plot(t_s, wanted, label="wanted", linewidth=3.5, alpha=0.6)
        upper.plot(t_s, felt, label="felt", linewidth=1.2)
        upper.set_ylabel(labels[0])
        figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=2)
        error = 1e3 * (felt - wanted)
        lower.plot(t_s, error, linewidth=1.2, color="C2")
        reach = 1.15 * np.abs(error[t_s > BEAT_S]).max()
        lower.set(ylim=(-reach, reach), xlim=(0, numbers.FIRST_S))
        lower.set(xlabel="time in s", ylabel=labels[1])
        figure.align_ylabels()

    return draw


def _printed_line(axes: "Axes", printed: Printed) -> None:
    axes.plot(AMPLITUDES_N, printed.force_n / AMPLITUDES_N, "--", color=_ink(), linewidth=1.2)
    level = 0.03
    side = 1 if printed == readings.MEASURED_FORCE else -1
    axes.annotate(
        printed.text,
        (printed.force_n / level, level),
        xytext=(6 * side, 0),
        textcoords="offset points",
        ha="left" if side > 0 else "right",
        va="bottom" if side > 0 else "top",
        fontsize="small",
    )


def _shares(axes: "Axes", spectrum: Spectrum, style: str, name: str) -> None:
    axes.plot(
        spectrum.frequency_hz,
        100 * spectrum.shares(),
        style,
        drawstyle="steps-post",
        label=name,
    )


def _printed_shares(axes: "Axes") -> None:
    limits_hz, shares = zip(*numbers.ENERGY_BELOW_HZ.items(), strict=True)
    axes.plot(limits_hz, 100 * np.array(shares), "o", color=_ink(), label="paper, as printed")


def _ink() -> str:
    """The theme's text colour."""
    import matplotlib

    return str(matplotlib.rcParams["text.color"])
