"""The contact between tip, rubber and fingertip: force for a position, and back."""

import math


class ContactLaw:
    """A spherical tip on a rubber layer (Hertz) in series with a springy fingertip.

    x = (F/C)^(2/3) + F/k with C = (4/3) E* √R. fingertip_n_per_m may be infinite: a rigid stop.
    Positions are in m from first touch, positive into the finger; forces in N, never pulling.
    finger_m_per_n: 1/k, which an observer may learn.
    """

    def __init__(
        self, tip_radius_m: float, reduced_modulus_pa: float, fingertip_n_per_m: float
    ) -> None:
        self._hertz = 4 / 3 * reduced_modulus_pa * math.sqrt(tip_radius_m)
        self._rubber: float = self._hertz ** (-2 / 3)
        self.finger_m_per_n = 1 / fingertip_n_per_m

    def position(self, force_n: float) -> float:
        """Tip position in m that presses with `force_n`; 0 for no force."""
        if force_n <= 0:
            return 0.0
        root = math.cbrt(force_n)
        return self._rubber * root * root + force_n * self.finger_m_per_n

    def stiffness(self, force_n: float) -> float:
        """dF/dx in N/m where the tip presses with `force_n`; 0 where it does not touch."""
        if force_n <= 0:
            return 0.0
        return 1 / (2 / 3 * self._rubber / math.cbrt(force_n) + self.finger_m_per_n)

    def force(self, position_m: float) -> float:
        """Force in N at a tip position; 0 where the tip does not touch."""
        if position_m <= 0:
            return 0.0
        rubber, finger = self._rubber, self.finger_m_per_n
        # In the cube root u of the force: finger u³ + rubber u² = x, convex for u > 0. Each
        # term alone bounds u from above, so Newton comes down to the root without overshoot.
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
