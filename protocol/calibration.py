"""Conversion between a film and its numbers: a straight calibration line and an ADC.

Each takes a number or an array and keeps its shape; a number stays a Python float, as the
display's loop reads one a tick.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from protocol.tactile import Film, Floats

# Fig. 4 of the paper: a straight line through about 110 mV at 2.5 N. Eq 21 says 118 times more.
FIG_4_VOLTS_PER_NEWTON = 0.110 / 2.5


@dataclass(frozen=True, slots=True)
class Calibration:
    """A sensor's straight line (Fig. 4): volts_per_newton, not 0, and volts at no force.

    Raises ValueError for a line that has no inverse.
    """

    volts_per_newton: float = FIG_4_VOLTS_PER_NEWTON
    offset_volts: float = 0.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.volts_per_newton) or self.volts_per_newton == 0:
            raise ValueError(
                f"volts_per_newton is {self.volts_per_newton}; it must be finite and not 0"
            )
        if not math.isfinite(self.offset_volts):
            raise ValueError(f"offset_volts is {self.offset_volts}; it must be finite")

    @classmethod
    def of_film(cls, film: Film) -> Self:
        """Return the line that eq 21 gives for a film."""
        return cls(film.volts_per_newton)

    def volts(self, force_n: Floats) -> Floats:
        """Voltage in V under a force in N."""
        return force_n * self.volts_per_newton + self.offset_volts

    def newtons(self, volts: Floats) -> Floats:
        """Force in N that makes a voltage in V."""
        return (volts - self.offset_volts) / self.volts_per_newton


@dataclass(frozen=True, slots=True)
class Adc:
    """An ideal converter of `bits` bits over ±range_volts, in two's complement.

    Code c, from −2^(bits−1) to 2^(bits−1) − 1, stands for c · step_volts: the range's lower end
    has a code, its upper end lies one step above the last. Raises ValueError for bits outside
    2 to 32 and for a range that is not above 0.
    """

    bits: int
    range_volts: float

    def __post_init__(self) -> None:
        if not 2 <= self.bits <= 32:
            raise ValueError(f"bits is {self.bits}; it must be in 2 to 32")
        if not 0 < self.step_volts < math.inf:
            raise ValueError(f"range_volts is {self.range_volts}; it must be above 0 and finite")

    @property
    def step_volts(self) -> float:
        """The voltage between two codes, in V."""
        return math.ldexp(self.range_volts, 1 - self.bits)

    def quantise(self, volts: Floats) -> Floats:
        """Return the nearest code's voltage in V; beyond the range, the last code's.

        Raises ValueError for NaN: no converter gives one, so what feeds it is at fault.
        """
        step, half = self.step_volts, 1 << (self.bits - 1)
        if isinstance(volts, np.ndarray):
            if np.isnan(volts).any():
                raise ValueError("a voltage is NaN")
            codes = np.clip(np.rint(volts / step), -half, half - 1)
            return codes * step
        if math.isnan(volts):
            raise ValueError("a voltage is NaN")
        return round(min(max(volts / step, -half), half - 1)) * step

    def clips(self, volts: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which of the voltages have no code near them: they are beyond the range."""
        half = 1 << (self.bits - 1)
        codes = np.rint(volts / self.step_volts)
        return (codes < -half) | (codes > half - 1)
