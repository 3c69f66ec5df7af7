"""Contact between tip, rubber and fingertip: force for a position, and back."""

import math


class ContactLaw:
    """A spherical tip on a rubber layer (Hertz) in series with an elastic fingertip.

    x = (F/C)^(2/3) + F/k with C = (4/3) E* √R. Positions are in m from first touch, positive into
    the finger; forces are in N and never pull.

    Parameters
    ----------
    tip_radius_m
        R in m.
    reduced_modulus_pa
        E* = E / (1 − ν²) of the rubber, in Pa.
    fingertip_n_per_m
        k in N/m; infinite for a rigid stop.

    Attributes
    ----------
    finger_m_per_n
        Compliance 1/k, which an observer may update.
    """

    def __init__(
        self, tip_radius_m: float, reduced_modulus_pa: float, fingertip_n_per_m: float
    ) -> None:
        self._hertz = 4 / 3 * reduced_modulus_pa * math.sqrt(tip_radius_m)
        self._rubber: float = self._hertz ** (-2 / 3)
        self.finger_m_per_n = 1 / fingertip_n_per_m

    def position(self, force_n: float) -> float:
        """Return the tip position in m for a force; 0 for no force."""
        if force_n <= 0:
            return 0.0
        root = math.cbrt(force_n)
        return self._rubber * root * root + force_n * self.finger_m_per_n

    def stiffness(self, force_n: float) -> float:
        """Return dF/dx in N/m at a force; 0 without contact."""
        if force_n <= 0:
            return 0.0
        return 1 / (2 / 3 * self._rubber / math.cbrt(force_n) + self.finger_m_per_n)

    def force(self, position_m: float) -> float:
        """Return the force in N at a tip position; 0 without contact."""
        if position_m <= 0:
            return 0.0
        rubber, finger = self._rubber, self.finger_m_per_n
        # With u the cube root of the force: finger u³ + rubber u² = x, convex for u > 0. The start
        # omits one term, so it is above the root; Newton's method then decreases monotonically.
        u = math.sqrt(position_m / rubber)
        if finger and u:
            u = min(u, math.cbrt(position_m / finger))
            for _ in range(60):
                step = (u * u * (finger * u + rubber) - position_m) / (
                    u * (3 * finger * u + 2 * rubber)
                )
                u -= step
                if step <= 1e-13 * u:
                    break
        return u * u * u


class LinearContact(ContactLaw):
    """Contact of constant stiffness in N/m, also for negative forces, for linear models."""

    def __init__(self, stiffness_n_per_m: float) -> None:
        self._stiffness_n_per_m = stiffness_n_per_m
        self.finger_m_per_n = 0.0

    def position(self, force_n: float) -> float:
        """Return the tip position in m for a force."""
        return force_n / self._stiffness_n_per_m

    def stiffness(self, force_n: float) -> float:
        """Return dF/dx in N/m."""
        return self._stiffness_n_per_m

    def force(self, position_m: float) -> float:
        """Return the force in N at a tip position."""
        return position_m * self._stiffness_n_per_m
