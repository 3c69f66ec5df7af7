"""The synthetic pulse that has the paper's spectrum, and its Welch spectrum (Figs 15 and 16).

The pulse has 75 beats/min and 1 N from peak to peak. Where errors are compared its mean is removed:
a PVDF film does not pass it, and an unknown preload would only add to the errors.
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from sensing_node.sources.heart import NOMINAL_BEAT_S
from sensing_node.sources.synthetic import PRESETS, SyntheticScene, SyntheticSource
from telepulse.document import Table, percent
from telepulse.paper.published import ENERGY_BELOW_HZ, FIRST_S, PULSE_PER_MIN

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


def beats_per_min() -> float:
    """Return the rate of our pulse by the interval between its highest peaks."""
    force_n = beats("paper", RATE_HZ, FIRST_S)
    peaks, _ = signal.find_peaks(force_n, height=0.9 * force_n.max())
    return float(60 * RATE_HZ / np.diff(peaks).mean())


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


def furthest_from(other: dict[float, float]) -> float:
    """Return the largest difference of our spectrum's printed shares from `other` ones."""
    return max(abs(spectra()["ours"].below(hz) - share) for hz, share in other.items())


def tables() -> dict[str, Table]:
    """Return the waves of our two pulses, and their energy below each printed frequency."""
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
        {"below": f"{limit_hz:g} Hz", "paper": percent(printed)}
        | {name: percent(share(limit_hz), ".2f") for name, share in shares.items()}
        for limit_hz, printed in ENERGY_BELOW_HZ.items()
    ]
    return {"waves": Table.of("", waves), "shares": Table.of("", rows)}
