"""Tissue under a probe: the artery as a tube that collapses, and the force against the depth.

Babbs CF, "Oscillometric measurement of systolic and diastolic blood pressures validated in a
physiologic mathematical model", BioMed Eng OnLine 2012, 11:56, gives the tube's law: compliance
falls exponentially with the transmural pressure on either side of zero.
"""

import math
from dataclasses import dataclass
from typing import Final

PASCALS_PER_MMHG: Final = 133.322
# Babbs's normal artery; a stiff one has 0.076 and 0.021 per mmHg.
COLLAPSE_PER_PA: Final = 0.11 / PASCALS_PER_MMHG
DISTENSION_PER_PA: Final = 0.03 / PASCALS_PER_MMHG


@dataclass(frozen=True, slots=True)
class TubeLaw:
    """Volume of an artery against the transmural pressure P, in units of its greatest compliance.

    dV/dP is exp(collapse · P) below zero, where the artery collapses, and exp(−distension · P)
    above, where its wall carries the load.

    collapse_per_pa, distension_per_pa: constants a and b of Babbs (2012), in 1/Pa.
    """

    collapse_per_pa: float = COLLAPSE_PER_PA
    distension_per_pa: float = DISTENSION_PER_PA

    def volume(self, transmural_pa: float) -> float:
        """Return the volume at a pressure in Pa; its unit is Pa too, since the compliance is 1."""
        a, b = self.collapse_per_pa, self.distension_per_pa
        if transmural_pa < 0:
            return math.exp(a * transmural_pa) / a
        return 1 / a - math.expm1(-b * transmural_pa) / b

    def height(self, outside_pa: float, diastolic_pa: float, systolic_pa: float) -> float:
        """Return the volume pulse's peak to peak for a pressure outside of the artery."""
        return self.volume(systolic_pa - outside_pa) - self.volume(diastolic_pa - outside_pa)

    @classmethod
    def highest_at_mean(cls, mean_share: float) -> "TubeLaw":
        """Return the law whose pulse is highest where the outside pressure is the mean arterial.

        mean_share: (mean − diastolic) / (systolic − diastolic), between 0 and 1.
        """
        return cls(COLLAPSE_PER_PA, COLLAPSE_PER_PA * mean_share / (1 - mean_share))


@dataclass(frozen=True, slots=True)
class StiffeningLaw:
    """Force against depth of a probe in soft tissue: F = knee · (exp(z / length) − 1).

    The stiffness (F + knee) / length rises with the force (Fung's exponential law).

    knee_n: force at which the stiffness is twice that of first touch. length_m: depth over which it
    rises by the factor e.
    """

    knee_n: float = 0.3
    length_m: float = 1.2e-3

    def force_n(self, depth_m: float) -> float:
        """Return the force in N at a depth; 0 without contact."""
        return self.knee_n * math.expm1(depth_m / self.length_m) if depth_m > 0 else 0.0

    def depth_m(self, force_n: float) -> float:
        """Return the depth in m at a force; 0 for no force."""
        return self.length_m * math.log1p(force_n / self.knee_n) if force_n > 0 else 0.0

    def stiffness_n_per_m(self, force_n: float) -> float:
        """Return dF/dz at a force; below 0 N, that of first touch."""
        return (max(force_n, 0.0) + self.knee_n) / self.length_m
