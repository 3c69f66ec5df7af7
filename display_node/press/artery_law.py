"""The artery under the probe as the finger models it: a tube law. Pure.

The law has five parameters with a meaning: gain of the film, mean arterial and pulse pressure as
forces of the probe, and the two constants of the tube. So what is learnt at some hold-down forces
predicts the others, where a curve without a law returns to a typical artery.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.tissue import TubeLaw

Floats = NDArray[np.float64]
# Mean arterial pressure and pulse pressure of a typical wrist under a probe of 1 cm², as forces;
# mean pressure above diastole, as a share of the pulse pressure.
TYPICAL_MEAN_N, TYPICAL_PULSE_N, MEAN_SHARE = 1.2, 0.52, 0.27
PA_PER_N: Final = 1e4
# Relative pressures are bounded, as noise on a closed or a wide artery would explain any.
LOWEST, HIGHEST = -1.0, 2.0
# Where the artery is open in diastole, pressures so far below the least plausible one are seen.
SEEN: Final = 0.7
# Where it is closed, readings within this share of the height from the foot are noise.
UNSEEN: Final = 0.004


@dataclass(frozen=True, slots=True)
class ArteryLaw:
    """Height and shape of the pulse at the film against the hold-down force.

    Attributes
    ----------
    gain
        Height in N per N of volume pulse.
    diastolic_n, pulse_n
        Diastolic pressure and pulse pressure, times the probe's area.
    collapse_per_n, distension_per_n
        Constants of the tube's law, over the probe's area.
    """

    gain: float
    diastolic_n: float
    pulse_n: float
    collapse_per_n: float
    distension_per_n: float

    def heights(self, forces_n: Floats) -> Floats:
        """Return the pulse's heights at hold-down forces."""
        return self._volumes(self.diastolic_n + self.pulse_n - forces_n) - self._volumes(
            self.diastolic_n - forces_n
        )

    def _volumes(self, transmural_n: Floats) -> Floats:
        a, b = self.collapse_per_n, self.distension_per_n
        closed = np.exp(a * np.minimum(transmural_n, 0.0)) / a
        return self.gain * (closed - np.expm1(-b * np.maximum(transmural_n, 0.0)) / b)

    def share(self, pressure: float, force_n: float) -> float:
        """Return the film's reading above its foot, over the height, at a hold-down force.

        pressure: of the artery, 0 at the typical diastole and 1 at the typical systole.
        """
        tube, low_n = self._tube(), self.diastolic_n - force_n
        foot = tube.volume(low_n)
        return (tube.volume(low_n + pressure * self.pulse_n) - foot) / (
            tube.volume(low_n + self.pulse_n) - foot
        )

    def pressure(self, share: float, force_n: float, diastole: float = 0.0) -> float:
        """Return the artery's pressure for a reading, as `share` is its inverse.

        Where the artery is closed, readings near the foot contain noise only.

        Parameters
        ----------
        share
            Reading above the foot, over the height.
        force_n
            Hold-down force.
        diastole
            Expected pressure in diastole, as `share` has it. It stands for what is not seen, and is
            the lowest plausible pressure there. Where the artery is open, lower ones are seen.
        """
        tube, low_n = self._tube(), self.diastolic_n - force_n
        a, b = self.collapse_per_n, self.distension_per_n
        foot = tube.volume(low_n)
        height = tube.volume(low_n + self.pulse_n) - foot
        if height <= 0.0:
            # So far beyond a closed artery nothing is seen, whatever a load cell reads.
            return min(max(diastole, LOWEST), HIGHEST)
        open_share = math.exp(a * min(low_n, 0.0))
        unseen = max(UNSEEN * (1.0 - open_share), 1e-9)
        expected = (tube.volume(low_n + diastole * self.pulse_n) - foot) / height
        beyond = share - expected
        # Deviations from the expected foot count as far as they exceed the noise.
        volume = foot + (expected + beyond**3 / (beyond**2 + unseen**2)) * height
        if volume <= 0.0:
            transmural_n = -math.inf
        elif volume < 1 / a:
            transmural_n = math.log(a * volume) / a
        else:
            transmural_n = -math.log(max(1 - b * (volume - 1 / a), 1e-9)) / b
        pressure = (transmural_n - low_n) / self.pulse_n
        return min(max(pressure, diastole - SEEN * open_share, LOWEST), HIGHEST)

    def _tube(self) -> TubeLaw:
        return TubeLaw(self.collapse_per_n, self.distension_per_n)
