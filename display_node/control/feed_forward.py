"""Feed-forward: the screw's path with which the tip follows a reference known in advance.

It inverts the contact law, the rotor's resonance and the backlash (decision 9). The playout buffer
holds the reference's next samples. So derivatives need no filter, and the backlash is crossed where
the reference turns, not after.
"""

import math
from collections import deque

from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene

# A turn smaller than this share of the backlash is not followed to the other flank.
TURN_SHARE = 0.25


class ScrewPath:
    """The screw's next position and speed, from a short horizon of reference forces.

    Attributes
    ----------
    horizon
        Number of ticks after the present one that the reference must cover.
    tip_m, screw_m
        Positions of tip and screw in m at the present tick's end.
    further_m
        Further travel of the screw in m if the speed is held beyond the tick.
    """

    def __init__(self, scene: StepperScene, law: ContactLaw, tick_s: float) -> None:
        self._law = law
        self._tick_s = tick_s
        self._rotor: tuple[float, float] | None = None
        self._gap: Gap | None = None
        self.horizon = 1
        if scene.rotor_resonance_hz is not None:
            w = 2 * math.pi * scene.rotor_resonance_hz
            self._rotor = scene.rotor_damping / (w * tick_s), 1 / (w * tick_s) ** 2
            self.horizon = 2
        if scene.backlash_m:
            self._gap = Gap(scene, tick_s)
            self.horizon = max(self.horizon, 2 + self._gap.lead)
        self._fed_m: float | None = None
        self.tip_m = self.screw_m = self.further_m = 0.0

    def advance(self, reference_n: list[float], held_s: float = 0.0) -> float:
        """Set the positions at this tick's end, and return its speed in m/s.

        Parameters
        ----------
        reference_n
            Reference force now and in each of the next `horizon` ticks, in N.
        held_s
            Expected holding time of the speed in s, if longer than a tick.
        """
        position = self._law.position
        self.tip_m = screw_m = position(reference_n[1])
        if self._rotor is not None:
            # The inverse x + (2ζ/ω) x' + x''/ω² is exact in continuous time, without zeros.
            slope, bend = self._rotor
            before_m, after_m = position(reference_n[0]), position(reference_n[2])
            screw_m += slope * (after_m - before_m) + bend * (after_m - 2 * screw_m + before_m)
        if self._gap is not None:
            screw_m += self._gap.cross([position(force_n) for force_n in reference_n[1:]])
        if self._fed_m is None:
            self._fed_m = position(reference_n[0]) + screw_m - self.tip_m
        self.screw_m = screw_m
        self.further_m = 0.0
        if held_s > self._tick_s:
            # A pulse's slope is no prediction for more than one further tick.
            slope_m_per_s = (self.tip_m - position(reference_n[0])) / self._tick_s
            self.further_m = slope_m_per_s * min(held_s - self._tick_s, self._tick_s)
        speed_m_per_s = (screw_m + self.further_m - self._fed_m) / max(held_s, self._tick_s)
        self._fed_m += speed_m_per_s * self._tick_s
        return speed_m_per_s

    def shift(self, travel_m: float) -> None:
        """Add a travel of the screw in m beyond the commanded one."""
        if self._fed_m is not None:
            self._fed_m += travel_m


class Gap:
    """Offset of the screw to the flank of the backlash that drives the tip.

    The change of flank is a zero-vibration input shape (Singer and Seering 1990): two steps, half a
    period of the rotor apart, after which the rotor is at rest.
    """

    def __init__(self, scene: StepperScene, tick_s: float) -> None:
        self._half_m = scene.backlash_m / 2
        self._least_turn_m = scene.backlash_m * TURN_SHARE
        self._extreme_m = -math.inf
        self._direction = 1
        # Shares of the offset now, `delay` ticks later and one tick after that.
        self._shares = 1.0, 0.0, 0.0
        damping, delay = scene.rotor_damping, 0
        if scene.rotor_resonance_hz is not None and damping < 1:
            damped = math.sqrt(1 - damping * damping)
            half_period = 1 / (2 * scene.rotor_resonance_hz * damped) / tick_s
            kept = math.exp(-damping * math.pi / damped)
            delay, part = int(half_period), half_period % 1.0
            late = kept / (1 + kept)
            self._shares = 1 - late, late * (1 - part), late * part
        # The steps begin this many ticks before the turn, so that the turn lies between them.
        self.lead = 1 if delay else 0
        self._past: deque[int] = deque([self._direction] * (delay + 2), delay + 2)

    def cross(self, tip_m: list[float]) -> float:
        """Return the screw's offset in m for the next tick; tip_m: positions from that tick on."""
        self._turn(tip_m[self.lead :])
        past = self._past
        past.append(self._direction)
        at_once, late, later = self._shares
        return self._half_m * (at_once * past[-1] + late * past[1] + later * past[0])

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
