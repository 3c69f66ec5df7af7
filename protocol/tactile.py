"""The tactile model: PVDF film and elastic half-space (Dargahi, Xie and Ji 2008, eqs 1-21).

Forces are in newtons and positive when they press; strains follow eq 16, so compression is
negative. Functions take a number or an array and keep its shape; a number stays a Python float, for
the speed of the display's loop. A film is read through a straight calibration line and an ADC.
"""

import math
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = TypeVar("Floats", float, NDArray[np.float64])
# Just noticeable difference of a force, as a share of the pulse's height: people notice 7 to 10 %.
JND: Final = 0.10


@dataclass(frozen=True, slots=True)
class Film:
    """A biaxial PVDF film loaded round its rim (eqs 1-8, 21).

    radius_m: contact radius r_pv. g31, g32: voltage coefficients in V·m/N. Table 1 prints g32 with
    the unit of a charge coefficient; here g32 = g31, as eq 2 requires for a biaxial film. The
    film's thickness cancels between eqs 2 and 4.
    """

    radius_m: float
    g31: float = 0.15
    g32: float = 0.15

    def __post_init__(self) -> None:
        if not 0 < self.radius_m < math.inf:
            raise ValueError(f"radius_m is {self.radius_m}; it must be above 0 and finite")
        if not 0 < self.g31 + self.g32 < math.inf:
            raise ValueError(f"g31 + g32 is {self.g31 + self.g32}; it must be above 0 and finite")

    @property
    def volts_per_newton(self) -> float:
        """Sensitivity (g31 + g32) / (2 π r), from eqs 2, 4 and 5."""
        return (self.g31 + self.g32) / (2 * math.pi * self.radius_m)


@dataclass(frozen=True, slots=True)
class ElasticLayer:
    """The rubber layer: an elastic half-space under a line load (eqs 9-20, Table 3).

    young_modulus_pa: above 0. thickness_m: depth d at which the strain is computed, above 0.
    poisson_ratio: 0 to 0.5. contact_length_m: length over which a force is distributed as the line
    load P of eq 9. The paper's numbers imply 1 m, which is the default.
    """

    young_modulus_pa: float = 0.05e9
    thickness_m: float = 2e-3
    poisson_ratio: float = 0.5
    contact_length_m: float = 1.0

    def __post_init__(self) -> None:
        for name in ("young_modulus_pa", "thickness_m", "contact_length_m"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ValueError(f"{name} is {value}; it must be above 0 and finite")
        if not 0 <= self.poisson_ratio <= 0.5:
            raise ValueError(f"poisson_ratio is {self.poisson_ratio}; it must be in 0 to 0.5")
        if not 1e-100 < abs(self.strain_per_newton) < 1e100:
            raise ValueError("the layer's strain per newton is not a usable number")

    @property
    def strain_per_newton(self) -> float:
        """On-axis strain εz of 1 N: 2 (ν² − 1) / (E π d L), in 1/N (eq 16)."""
        # Separate divisions, since the product of small divisors could be 0.
        pressed = 2 * (self.poisson_ratio**2 - 1) / (math.pi * self.young_modulus_pa)
        return pressed / self.thickness_m / self.contact_length_m

    def strain(self, force_n: Floats) -> Floats:
        """Return the on-axis strain εz at depth d under a force in N: h1 and h2 of eqs 17-20."""
        return force_n * self.strain_per_newton

    def force(self, strain: Floats) -> Floats:
        """Return the force in N that makes an on-axis strain εz: the inverse of eqs 17-20."""
        return strain / self.strain_per_newton


def half_space_stress(
    line_load_n_per_m: float, x_m: NDArray[np.float64], z_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the stress field of a line load on a half-space in plane strain (eqs 9-12).

    The printed equations drop the powers; this is the standard (Flamant) solution, which gives
    eqs 11-12 on the axis.

    Parameters
    ----------
    line_load_n_per_m : float
        Load in N per m of its length; positive presses.
    x_m, z_m : ndarray
        Positions in m along the surface, and depths in m, above 0. The shapes broadcast.

    Returns
    -------
    σx_pa, σz_pa : ndarray
        Stresses in Pa along the surface and in depth, of the broadcast shape.

    Raises
    ------
    ValueError
        If a depth is not above 0.
    """
    if not np.all(z_m > 0):
        raise ValueError("z_m must be above 0: the stress is singular at the load itself")
    # Dividing before raising to powers keeps the far and the near field from overflowing.
    ratio = x_m / z_m
    common = -2 * line_load_n_per_m / (math.pi * z_m * (1 + ratio**2) ** 2)
    return common * ratio**2, common


def matching_force_ratio(sensing: ElasticLayer, display: ElasticLayer) -> float:
    """Return the ratio of finger to wrist force that makes both strains equal (eqs 17-20)."""
    return sensing.strain_per_newton / display.strain_per_newton


# Fig. 4 of the paper: a straight line through about 110 mV at 2.5 N. Eq 21 gives 118 times more.
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

    def volts(self, force_n: Floats) -> Floats:
        """Return the voltage in V under a force in N."""
        return force_n * self.volts_per_newton + self.offset_volts

    def newtons(self, volts: Floats) -> Floats:
        """Return the force in N that makes a voltage in V."""
        return (volts - self.offset_volts) / self.volts_per_newton


@dataclass(frozen=True, slots=True)
class Adc:
    """An ideal converter of `bits` bits over ±range_volts, in two's complement.

    Code c, from −2^(bits−1) to 2^(bits−1) − 1, means c · step_volts. The range's lower end has a
    code; its upper end is one step above the last code. Raises ValueError for bits outside 2 to 32
    and for a range that is not above 0.
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

        Raises ValueError for NaN, which is a fault of the caller: no converter has a code for it.
        """
        step, half = self.step_volts, 1 << (self.bits - 1)
        if np.isnan(volts).any() if isinstance(volts, np.ndarray) else math.isnan(volts):
            raise ValueError("a voltage is NaN")
        if isinstance(volts, np.ndarray):
            return np.clip(np.rint(volts / step), -half, half - 1) * step
        return round(min(max(volts / step, -half), half - 1)) * step

    def clips(self, volts: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which voltages are beyond the range, with no code next to them."""
        half = 1 << (self.bits - 1)
        codes = np.rint(volts / self.step_volts)
        return (codes < -half) | (codes > half - 1)
