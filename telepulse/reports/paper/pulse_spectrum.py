"""The synthetic pulse of this report and its Welch spectrum (Figs 15 and 16).

The pulse has 75 beats/min and 1 N from peak to peak. Where errors are compared it has no mean:
a PVDF film passes none, and a preload of unknown size would only add to the errors.
"""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from sensing_node.sources.synthetic import NOMINAL_BEAT_S, PRESETS, SyntheticScene, SyntheticSource
from telepulse.reports.document import Chapter, Plot, Table, text_colour
from telepulse.reports.paper import published
from telepulse.reports.paper.published import ENERGY_BELOW_HZ, PULSE_PER_MIN, SPECTRUM_TO_HZ

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Preset = Literal["paper", "wide"]
# Slow parts of the spectrum's pulse, over the standard deviation of its beats. They are fitted, as
# the waves' widths and heights are, to the energy shares that the paper prints.
SLOW_DC = 0.034
SLOW_RESPIRATION = 0.256
SLOW_RESPIRATION_HZ = 0.25
# Welch's settings are ours.
RATE_HZ = 1000.0
SECONDS = 15.0
SEGMENT = 3333
TRANSFORM = 4096
BEAT_S = 0.8


def beats(preset: Preset, rate_hz: float, seconds: float) -> NDArray[np.float64]:
    """Return a mean-free pulse of 1 N peak to peak, from 0 to `seconds` with both ends, in N."""
    return _pulse(preset, rate_hz, seconds, preload_n=0.0, respiration=0.0)


def beats_with_slow_parts(preset: Preset, rate_hz: float, seconds: float) -> NDArray[np.float64]:
    """Return `beats` with the constant and the respiration of the paper's spectrum, in N."""
    return _pulse(preset, rate_hz, seconds, SLOW_DC * deviation_n(preset), SLOW_RESPIRATION)


def deviation_n(preset: Preset) -> float:
    """Return the standard deviation of `beats` over a beat in N: the RMSE of doing nothing."""
    return float(beats(preset, 1e4, NOMINAL_BEAT_S)[:-1].std())


def raw_mean_n(preset: Preset) -> float:
    """Return the mean over a beat in N of the bare waves, before it is taken out."""
    # Between two beats the bare waves are all but 0, so the mean is what lifts that floor.
    return -float(beats(preset, 1e4, NOMINAL_BEAT_S).min())


def _pulse(
    preset: Preset, rate_hz: float, seconds: float, preload_n: float, respiration: float
) -> NDArray[np.float64]:
    scene = SyntheticScene.model_validate(
        {
            "kind": "synthetic",
            "preset": preset,
            "rate": f"{rate_hz} Hz",
            "heart_rate": f"{PULSE_PER_MIN} /min",
            "peak_to_peak": "1 N",
            "preload": f"{preload_n} N",
            "respiration": respiration,
            "respiration_rate": f"{SLOW_RESPIRATION_HZ} Hz",
        }
    )
    return SyntheticSource(scene).take(round(seconds * rate_hz) + 1)[:, 0]


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power density in N²/Hz at frequencies in Hz from 0 to half the rate."""

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
        area = np.trapezoid(
            np.append(self.density[inside], at_limit),
            np.append(self.frequency_hz[inside], limit_hz),
        )
        return float(area / np.trapezoid(self.density, self.frequency_hz))


def welch(force_n: NDArray[np.float64]) -> Spectrum:
    """Estimate the spectrum of the first 15 s at 1 kHz by Welch's method, nothing detrended."""
    frequency_hz, density = signal.welch(
        force_n[: round(SECONDS * RATE_HZ)],
        fs=RATE_HZ,
        window="hamming",
        nperseg=SEGMENT,
        noverlap=SEGMENT // 2,
        nfft=TRANSFORM,
        detrend=False,
    )
    return Spectrum(np.asarray(frequency_hz, np.float64), np.asarray(density, np.float64))


class PulseSpectra(NamedTuple):
    """Spectra of the fitted pulse, and of the pulses that might have been used instead."""

    paper: Spectrum
    mean_kept: Spectrum
    mean_removed: Spectrum
    wide: Spectrum


@cache
def spectra() -> PulseSpectra:
    """Return the spectra of the paper's pulse and its alternatives."""
    bare_n = beats("paper", RATE_HZ, SECONDS)
    return PulseSpectra(
        paper=welch(beats_with_slow_parts("paper", RATE_HZ, SECONDS)),
        mean_kept=welch(bare_n + raw_mean_n("paper")),
        mean_removed=welch(bare_n - bare_n.mean()),
        wide=welch(beats_with_slow_parts("wide", RATE_HZ, SECONDS)),
    )


def chapter() -> Chapter:
    """Describe the pulse with the paper's spectrum, and the wide one."""
    paper, _, _, wide = spectra()
    moved = max(abs(paper.below(hz) - paper.below_by_trapezoids(hz)) for hz in ENERGY_BELOW_HZ)
    narrow_ms, broad_ms = (
        [1e3 * wave.width_s for wave in PRESETS[name]] for name in ("paper", "wide")
    )
    return Chapter(
        "The pulse and its spectrum",
        (
            "The paper prints five shares of energy and names Welch's method; its settings here"
            f" are ours: {SECONDS:g} s at {RATE_HZ / 1000:g} kHz, Hamming windows of"
            f" {SEGMENT} samples with half overlap, a transform of {TRANSFORM}, nothing detrended."
            " A share is the sum of the bins below its frequency over the sum of all.",
            f"The pulse is three Gaussians a beat at {PULSE_PER_MIN} beats/min without their"
            " mean. Added to it are, in units of their standard deviation, a constant of"
            f" {SLOW_DC} and respiration of {SLOW_RESPIRATION} RMS at {SLOW_RESPIRATION_HZ} Hz. All"
            " of these were fitted to the five shares. The agreement shows that such a pulse"
            " exists, not that it was the paper's.",
            "The lower shares depend on choices that the paper does not state. Straight lines"
            f" between the bins move one of them by {100 * moved:.1f} points, and the treatment of"
            " the mean alone decides the lowest.",
            "The preset “wide” is a typical radial pulse, with waves of"
            f" {min(broad_ms):.0f} to {max(broad_ms):.0f} ms instead of {min(narrow_ms):.0f} to"
            f" {max(narrow_ms):.0f} ms. It has {100 * wide.below(5.0):.1f} % of its energy below"
            f" 5 Hz, where the paper has {100 * paper.below(5.0):.1f} %: the paper's pulse is"
            " sharper than a radial pulse usually is, and harder to follow. Its standard deviation"
            f" is {deviation_n('wide'):.3f} of its height, the paper's {deviation_n('paper'):.3f}.",
        ),
        (_waves_table(), _shares_table()),
        (_pulse_plot(), _spectrum_plot(paper), _presets_plot()),
    )


def _waves_table() -> Table:
    rows = tuple(
        (
            f"{preset}, wave {number}",
            f"{wave.amplitude:g}",
            f"{1e3 * wave.centre_s:g} ms",
            f"{1e3 * wave.width_s:g} ms",
        )
        for preset, waves in PRESETS.items()
        for number, wave in enumerate(waves, 1)
    )
    columns = ("wave", "amplitude", "centre", "width (deviation)")
    return Table("A beat of both presets", columns, rows)


def _shares_table() -> Table:
    paper, mean_kept, mean_removed, wide = spectra()
    shares = {
        "ours": paper.below,
        "ours by trapezoids": paper.below_by_trapezoids,
        "beats alone, mean kept": mean_kept.below,
        "beats alone, mean removed": mean_removed.below,
        "wide": wide.below,
    }
    rows = tuple(
        (
            f"{limit_hz:g} Hz",
            f"{100 * printed:.1f} %",
            *(f"{100 * share(limit_hz):.2f} %" for share in shares.values()),
        )
        for limit_hz, printed in ENERGY_BELOW_HZ.items()
    )
    return Table(
        "Energy below a frequency",
        ("below", "paper", *shares),
        rows,
        "Mean kept: the Gaussians as they are, on zero. “wide” has the same constant and"
        " respiration as ours, in units of its own standard deviation.",
    )


def _pulse_plot() -> Plot:
    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        force_n = beats_with_slow_parts("paper", RATE_HZ, published.FIRST_S)
        axes.plot(np.arange(len(force_n)) / RATE_HZ, force_n)
        axes.set(xlabel="time in s", ylabel="force in N, beats of 1 N", xlim=(0, published.FIRST_S))

    return Plot(
        "pulse",
        "Fig. 15: the synthetic pulse at 75 beats/min with its respiration. The height is one unit"
        " here, since the paper gives none in newtons.",
        draw,
    )


def _spectrum_plot(paper: Spectrum) -> Plot:
    def draw(figure: "Figure") -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        upper.plot(paper.frequency_hz, paper.density)
        upper.set(yscale="log", ylim=(1e-9, 1), ylabel="density in N²/Hz")
        _plot_shares(lower, ours=paper)
        lower.set(ylabel="energy below in %", xlabel="frequency in Hz", xlim=(0, SPECTRUM_TO_HZ))

    return Plot("spectrum", "Fig. 16: Welch spectrum of the pulse, and the energy below.", draw)


def _presets_plot() -> Plot:
    def draw(figure: "Figure") -> None:
        left, right = figure.subplots(1, 2)
        presets: tuple[tuple[Preset, str], ...] = (("paper", "-"), ("wide", "--"))
        for name, style in presets:
            force_n = beats(name, RATE_HZ, BEAT_S)
            left.plot(1e3 * np.arange(len(force_n)) / RATE_HZ, force_n, style, label=name)
        left.set(xlabel="time in ms", ylabel="force in N, beats of 1 N")
        left.legend(loc="upper right")
        _plot_shares(right, paper=spectra().paper, wide=spectra().wide)
        right.set(xlabel="frequency in Hz", ylabel="energy below in %")
        right.set(xscale="log", xlim=(0.3, SPECTRUM_TO_HZ))
        right.set_xticks(list(ENERGY_BELOW_HZ), [f"{limit_hz:g}" for limit_hz in ENERGY_BELOW_HZ])
        right.set_xticks([], minor=True)

    return Plot("presets", "A beat of both pulses, and the energy below a frequency.", draw)


def _plot_shares(axes: "Axes", **spectra: Spectrum) -> None:
    """Plot the energy below each frequency of some spectra, beside the printed shares."""
    for style, (name, spectrum) in zip(("-", "--"), spectra.items(), strict=False):
        share = 100 * spectrum.shares()
        axes.plot(spectrum.frequency_hz, share, style, drawstyle="steps-post", label=name)
    limits_hz, shares = zip(*ENERGY_BELOW_HZ.items(), strict=True)
    axes.plot(limits_hz, 100 * np.array(shares), "o", color=text_colour(), label="as printed")
    axes.legend(loc="lower right")
