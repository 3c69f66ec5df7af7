"""Feed-forward: the screw's path with which the tip follows a reference known in advance.

It inverts the contact law, the rotor's resonance and the backlash (decision 9), and shapes the path
of a rotor that rings (decision 35). The playout buffer holds the reference's next samples. So
derivatives need no filter, and the backlash is crossed where the reference turns, not after.
"""

import math

from display_node.control.shaper import InputShaper, rotor_rings, shaper_weights
from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene
from display_node.plant.stepper import Backlash, Rotor

# A turn smaller than this share of the backlash is not followed to the other flank.
TURN_SHARE = 0.25


class ScrewPath:
    """The screw's next position and speed, from a short horizon of reference forces.

    Attributes
    ----------
    horizon
        Number of ticks after the present one that the reference must cover.
    shaper_delay_s
        Delay in s of the shaper, 0 without one: the reference begins this much later than now.
    shaped
        True where the rotor rings, and the path is shaped.
    tip_m, screw_m
        Positions of tip and screw in m at the present tick's end.
    further_m
        Further travel of the screw in m if the speed is held beyond the tick.
    """

    def __init__(self, scene: StepperScene, law: ContactLaw, tick_s: float) -> None:
        self._law = law
        self._tick_s = tick_s
        self._inverse: tuple[float, float] | None = None
        self._shaper: InputShaper | None = None
        self._gap: Gap | None = None
        self.horizon, self.shaper_delay_s = 1, 0.0
        if scene.rotor_resonance_hz is not None:
            hz, damping = scene.rotor_resonance_hz, scene.rotor_damping
            w = 2 * math.pi * hz
            bend_s2 = 1 / w**2
            if rotor_rings(hz, damping, tick_s):
                weights = shaper_weights(hz, damping, tick_s)
                self._shaper = shaper = InputShaper(weights, tick_s)
                self._rotor = Rotor(hz, damping, tick_s)
                self._backlash = Backlash(scene.backlash_m)
                self.shaper_delay_s = shaper.delay_s
                # The shaper smooths the path by half its variance times x''.
                bend_s2 -= shaper.spread_s2 / 2
            self._inverse = damping / (w * tick_s), bend_s2 / tick_s**2
            self.horizon = 2
        if scene.backlash_m:
            self._gap = Gap(scene.backlash_m)
            self.horizon = 2
        self.shaped = self._shaper is not None
        self._fed_m: float | None = None
        self.tip_m = self.screw_m = self.further_m = 0.0

    def advance(
        self,
        reference_n: list[float],
        held_s: float = 0.0,
        ticks: int = 1,
        fastest_m_per_s: float = math.inf,
        furthest_m: float = math.inf,
    ) -> float:
        """Set the positions at this tick's end, and return its speed in m/s.

        Parameters
        ----------
        reference_n
            Reference force now and in each of the next `horizon` ticks, in N.
        held_s
            Expected holding time of the speed in s, if longer than a tick.
        ticks
            Ticks since the last call.
        fastest_m_per_s, furthest_m
            Bounds of a shaped path: of the screw's speed, and of the tip's position in m.
        """
        position = self._law.position
        tip_m = screw_m = before_m = position(reference_n[1])
        offset_m, shaper, holds = 0.0, self._shaper, held_s > self._tick_s
        if holds or self._inverse is not None or self._fed_m is None:
            before_m = position(reference_n[0])
        if self._inverse is not None:
            # The inverse x + (2ζ/ω) x' + x''/ω² is exact in continuous time, without zeros.
            slope, bend = self._inverse
            if ticks > 1:
                # Held for some ticks, the bend of a corner would be too large.
                bend = 0.0
            after_m = position(reference_n[2])
            screw_m += slope * (after_m - before_m) + bend * (after_m - 2 * screw_m + before_m)
        if self._gap is not None:
            offset_m = self._gap.cross([position(force_n) for force_n in reference_n[1:]])
        if shaper is None:
            screw_m += offset_m
            if self._fed_m is None:
                self._fed_m = before_m + screw_m - tip_m
            travel_m = tip_m - before_m
        else:
            if self._fed_m is None:
                self._fed_m = self.screw_m = self._rotor.position_m = before_m + offset_m
                shaper.start(self._fed_m)
            wanted_m = min(furthest_m, max(0.0, screw_m)) + offset_m
            screw_m = shaper.advance(wanted_m, fastest_m_per_s * self._tick_s, ticks)
            tip_m = self._backlash.step(self._rotor.step(self.screw_m, screw_m))
            travel_m = (screw_m - self.screw_m) / ticks
        self.tip_m, self.screw_m, self.further_m = tip_m, screw_m, 0.0
        if holds:
            # A pulse's slope is no prediction for more than one further tick.
            slope_m_per_s = travel_m / self._tick_s
            self.further_m = slope_m_per_s * min(held_s - self._tick_s, self._tick_s)
        held_s = held_s if holds else self._tick_s
        speed_m_per_s = (screw_m + self.further_m - self._fed_m) / held_s
        self._fed_m += speed_m_per_s * self._tick_s
        return speed_m_per_s

    def shift(self, travel_m: float) -> None:
        """Add a travel of the screw in m beyond the commanded one."""
        if self._fed_m is not None:
            self._fed_m += travel_m


class Gap:
    """Offset of the screw to the flank of the backlash that drives the tip."""

    def __init__(self, backlash_m: float) -> None:
        self._half_m = backlash_m / 2
        self._least_turn_m = backlash_m * TURN_SHARE
        self._extreme_m = -math.inf
        self._direction = 1

    def cross(self, tip_m: list[float]) -> float:
        """Return the screw's offset in m for the next tick; tip_m: positions from that tick on."""
        self._turn(tip_m)
        return self._half_m * self._direction

    def _turn(self, tip_m: list[float]) -> None:
        direction = self._direction
        self._extreme_m = extreme_m = max(self._extreme_m, tip_m[0] * direction)
        for position_m in tip_m:
            if position_m * direction > extreme_m:
                return
            if position_m * direction < extreme_m - self._least_turn_m:
                self._direction = -direction
                self._extreme_m = -tip_m[0] * direction
                return
