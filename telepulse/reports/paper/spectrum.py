"""The pulse's Welch spectrum and the energy below a frequency (Fig. 16)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

RATE_HZ = 1000.0
SECONDS = 15.0
SEGMENT = 3333
TRANSFORM = 4096


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power density in N²/Hz at frequencies in Hz from 0 to half the rate."""

    frequency_hz: NDArray[np.float64]
    density: NDArray[np.float64]

    def shares(self) -> NDArray[np.float64]:
        """Share of the energy up to each frequency, by sums of the estimate's bins."""
        return np.asarray(np.cumsum(self.density) / self.density.sum())

    def below(self, limit_hz: float) -> float:
        """Share of the energy in the bins below `limit_hz`."""
        return float(self.density[self.frequency_hz < limit_hz].sum() / self.density.sum())

    def below_by_trapezoids(self, limit_hz: float) -> float:
        """Share of the area under the density, drawn straight between bins, to `limit_hz`."""
        inside = self.frequency_hz < limit_hz
        at_limit = np.interp(limit_hz, self.frequency_hz, self.density)
        area = np.trapezoid(
            np.append(self.density[inside], at_limit),
            np.append(self.frequency_hz[inside], limit_hz),
        )
        return float(area / np.trapezoid(self.density, self.frequency_hz))


def welch(force_n: NDArray[np.float64]) -> Spectrum:
    """Welch's estimate of 15 s at 1 kHz; the paper names Welch, the settings are ours.

    Hamming windows of 3333 samples with half overlap, a transform of 4096, nothing detrended.
    """
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
