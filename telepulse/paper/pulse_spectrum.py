"""The synthetic pulse of this report and its Welch spectrum (Figs 15 and 16).

The pulse has 75 beats/min and 1 N from peak to peak. Where errors are compared its mean is removed:
a PVDF film does not pass it, and an unknown preload would only add to the errors.
"""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from sensing_node.sources.heart import NOMINAL_BEAT_S
from sensing_node.sources.synthetic import PRESETS, SyntheticScene, SyntheticSource
from telepulse.document import Chapter, Plot, Table, text_colour
from telepulse.paper.published import (
    ENERGY_BELOW_HZ,
    FIRST_S,
    PULSE_PER_MIN,
    SPECTRUM_TO_HZ,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Preset = Literal["paper", "wide"]
# Names of the presets in the report, where “paper” would be taken for the paper's own pulse.
PRESET_NAMES: dict[Preset, str] = {"paper": "ours, fitted", "wide": "ours, wide"}
# Slow parts of the pulse, as multiples of the standard deviation of its beats. Like the waves'
# widths and heights, they are fitted to the energy shares that the paper prints.
SLOW_DC = 0.034
SLOW_RESPIRATION = 0.256
SLOW_RESPIRATION_HZ = 0.25
# Welch's settings are ours.
RATE_HZ = 1000.0
SECONDS = 15.0
SEGMENT = 3333
TRANSFORM = 4096


def beats(
    preset: Preset, rate_hz: float, seconds: float, slow_parts: bool = False
) -> NDArray[np.float64]:
    """Return a pulse of 1 N peak to peak, from 0 to `seconds` with both ends, in N.

    The slow parts are the constant and the respiration of the paper's spectrum; without them the
    pulse has no mean.
    """
    scene = {
        "kind": "synthetic",
        "preset": preset,
        "rate": f"{rate_hz} Hz",
        "heart_rate": f"{PULSE_PER_MIN} /min",
        "peak_to_peak": "1 N",
        "preload": f"{SLOW_DC * deviation_n(preset) if slow_parts else 0.0} N",
        "respiration": SLOW_RESPIRATION if slow_parts else 0.0,
        "respiration_rate": f"{SLOW_RESPIRATION_HZ} Hz",
    }
    source = SyntheticSource(SyntheticScene.model_validate(scene))
    return source.take(round(seconds * rate_hz) + 1)[:, 0]


def deviation_n(preset: Preset) -> float:
    """Return the standard deviation of `beats` over a beat in N: the RMSE of doing nothing."""
    return float(beats(preset, 1e4, NOMINAL_BEAT_S)[:-1].std())


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power density at frequencies in Hz from 0 to half the rate.

    In N²/Hz of a pulse of 1 N from peak to peak, or in 1/Hz over its height.
    """

    frequency_hz: NDArray[np.float64]
    density: NDArray[np.float64]

    def shares(self) -> NDArray[np.float64]:
        """Return the share of the energy up to each frequency, by sums of the bins."""
        return np.asarray(np.cumsum(self.density) / self.density.sum())

    def below(self, limit_hz: float) -> float:
        """Return the share of the energy in the bins below `limit_hz`."""
        return float(self.density[self.frequency_hz < limit_hz].sum() / self.density.sum())

    def below_by_trapezoids(self, limit_hz: float) -> float:
        """Return the share of the area below `limit_hz`, with straight lines between the bins."""
        inside = self.frequency_hz < limit_hz
        at_limit = np.interp(limit_hz, self.frequency_hz, self.density)
        density = np.append(self.density[inside], at_limit)
        area = np.trapezoid(density, np.append(self.frequency_hz[inside], limit_hz))
        return float(area / np.trapezoid(self.density, self.frequency_hz))


def welch(force_n: NDArray[np.float64]) -> Spectrum:
    """Estimate the spectrum of the first 15 s at 1 kHz by Welch's method, nothing detrended."""
    force_n = force_n[: round(SECONDS * RATE_HZ)]
    windows = (SEGMENT, SEGMENT // 2, TRANSFORM)
    return Spectrum(*signal.welch(force_n, RATE_HZ, "hamming", *windows, detrend=False))


@cache
def spectra() -> dict[str, Spectrum]:
    """Return the spectra of our pulse, and of possible alternatives."""
    bare_n = beats("paper", RATE_HZ, SECONDS)
    # Between two beats the waves are almost 0, so the lowest value is minus their mean.
    raw_mean_n = -beats("paper", 1e4, NOMINAL_BEAT_S).min()
    return {
        "ours": welch(beats("paper", RATE_HZ, SECONDS, slow_parts=True)),
        "beats alone, mean kept": welch(bare_n + raw_mean_n),
        "beats alone, mean removed": welch(bare_n - bare_n.mean()),
        "wide": welch(beats("wide", RATE_HZ, SECONDS, slow_parts=True)),
    }


def chapter() -> Chapter:
    """Describe the pulse with the paper's spectrum, and the wide one."""
    paper, wide = spectra()["ours"], spectra()["wide"]
    moved = max(abs(paper.below(hz) - paper.below_by_trapezoids(hz)) for hz in ENERGY_BELOW_HZ)
    narrow_ms, broad_ms = (
        [1e3 * wave.width_s for wave in PRESETS[name]] for name in ("paper", "wide")
    )
    paragraphs = (
        "The paper prints five shares of energy and names Welch's method; its settings here are"
        f" ours: {SECONDS:g} s at {RATE_HZ / 1000:g} kHz, Hamming windows of {SEGMENT} samples with"
        f" half overlap, a transform of {TRANSFORM}, nothing detrended. A share is the sum of the"
        " bins below its frequency over the sum of all.",
        f"The pulse is three Gaussians a beat at {PULSE_PER_MIN} beats/min without their mean."
        f" Added to it are, in units of their standard deviation, a constant of {SLOW_DC} and"
        f" respiration of {SLOW_RESPIRATION} RMS at {SLOW_RESPIRATION_HZ} Hz. All of these were"
        " fitted to the five shares. The agreement shows that such a pulse exists, not that it was"
        " the paper's.",
        "The lower shares depend on choices that the paper does not state. Straight lines between"
        f" the bins move one of them by {100 * moved:.1f} points, and the treatment of the mean"
        " alone decides the lowest.",
        "The second pulse, “ours, wide”, is a typical radial pulse, with waves of"
        f" {min(broad_ms):.0f} to {max(broad_ms):.0f} ms instead of {min(narrow_ms):.0f} to"
        f" {max(narrow_ms):.0f} ms. It has {100 * wide.below(5.0):.1f} % of its energy below 5 Hz,"
        f" where the paper has {100 * paper.below(5.0):.1f} %: the paper's pulse is sharper than a"
        " radial pulse usually is, and harder to follow. Its standard deviation is"
        f" {deviation_n('wide'):.3f} of its height, the paper's {deviation_n('paper'):.3f}.",
    )
    pulse = (
        "Fig. 15: our synthetic pulse at 75 beats/min with its respiration, over the height of a"
        " beat, since the paper gives none in newtons."
    )
    spectrum = (
        "Fig. 16: Welch spectrum of our pulse over the height of a beat, and the energy below a"
        " frequency."
    )
    presets = (
        "A beat of our two synthetic pulses, fitted to the paper's energy shares and wide, and the"
        " energy below a frequency. The points are the paper's."
    )
    plots = (
        Plot("pulse", pulse, _draw_pulse),
        Plot("spectrum", spectrum, _draw_spectrum),
        Plot("presets", presets, _draw_presets),
    )
    return Chapter("The pulse and its spectrum", paragraphs, _tables(), plots)


def _tables() -> tuple[Table, Table]:
    waves = [
        {
            "wave": f"{PRESET_NAMES[preset]}, wave {number}",
            "amplitude": f"{wave.amplitude:g}",
            "centre": f"{1e3 * wave.centre_s:g} ms",
            "width (deviation)": f"{1e3 * wave.width_s:g} ms",
        }
        for preset in PRESET_NAMES
        for number, wave in enumerate(PRESETS[preset], 1)
    ]
    ours = spectra()["ours"]
    shares = {"ours, fitted": ours.below, "the same by trapezoids": ours.below_by_trapezoids}
    shares |= {
        "ours, wide" if name == "wide" else name: each.below
        for name, each in spectra().items()
        if name != "ours"
    }
    rows = [
        {"below": f"{limit_hz:g} Hz", "paper": f"{100 * printed:.1f} %"}
        | {name: f"{100 * share(limit_hz):.2f} %" for name, share in shares.items()}
        for limit_hz, printed in ENERGY_BELOW_HZ.items()
    ]
    note = (
        "Mean kept: the Gaussians as they are, on zero. “Ours, wide” has the same constant and"
        " respiration as “ours, fitted”, in units of its own standard deviation."
    )
    shares_table = Table.of("Energy below a frequency", rows, note)
    return Table.of("A beat of our two pulses", waves), shares_table


def _draw_pulse(figure: "Figure") -> None:
    axes = figure.subplots()
    force_n = beats("paper", RATE_HZ, FIRST_S, slow_parts=True)
    axes.plot(np.arange(len(force_n)) / RATE_HZ, force_n)
    axes.set(xlabel="time in s", ylabel="force over the height of a beat", xlim=(0, FIRST_S))


def _draw_spectrum(figure: "Figure") -> None:
    paper = spectra()["ours"]
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot(paper.frequency_hz, paper.density)
    upper.set(yscale="log", ylim=(1e-9, 1), ylabel="density in 1/Hz")
    _plot_shares(lower, paper)
    lower.set(ylabel="energy below in %", xlabel="frequency in Hz", xlim=(0, SPECTRUM_TO_HZ))


def _draw_presets(figure: "Figure") -> None:
    left, right = figure.subplots(1, 2)
    for (name, shown), style in zip(PRESET_NAMES.items(), ("-", "--"), strict=True):
        force_n = beats(name, RATE_HZ, NOMINAL_BEAT_S)
        left.plot(1e3 * np.arange(len(force_n)) / RATE_HZ, force_n, style, label=shown)
    left.set(xlabel="time in ms", ylabel="force over the height of a beat")
    left.legend(loc="upper right")
    _plot_shares(right, spectra()["ours"], spectra()["wide"])
    right.set(xlabel="frequency in Hz", ylabel="energy below in %")
    right.set(xscale="log", xlim=(0.3, SPECTRUM_TO_HZ))
    right.set_xticks(list(ENERGY_BELOW_HZ), [f"{limit_hz:g}" for limit_hz in ENERGY_BELOW_HZ])
    right.set_xticks([], minor=True)


def _plot_shares(axes: "Axes", *spectra: Spectrum) -> None:
    """Plot the energy below each frequency of the presets' spectra, beside the printed shares."""
    for style, name, spectrum in zip(("-", "--"), PRESET_NAMES.values(), spectra, strict=False):
        share = 100 * spectrum.shares()
        axes.plot(spectrum.frequency_hz, share, style, drawstyle="steps-post", label=name)
    limits_hz, shares = zip(*ENERGY_BELOW_HZ.items(), strict=True)
    axes.plot(
        limits_hz, 100 * np.array(shares), "o", color=text_colour(), label="paper, as printed"
    )
    axes.legend(loc="lower right")
