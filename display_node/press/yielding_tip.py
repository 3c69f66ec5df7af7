"""The tip of a real bench under a finger that presses: it yields by the model of the tissue. Pure.

A hand keeps its force and follows the tip, so on a real bench a force loop alone does not fix the
tip's place: a target below the press lets the tip run away from the hand, one above it chases the
hand. Here the loop renders the pulse around the press, and the drive's position follows the model.
"""

import math
from typing import Final

from display_node.hardware import Hardware
from display_node.plant.contact import ContactLaw
from display_node.press.local_press import LocalPress

# Film and press sensor differ in zero and gain: their difference is forgotten over this time.
FORGET_S: Final = 0.5
# The same while the finger moves, which both measure with other lags.
MOVING_S: Final = 0.05
# The tip returns to the model's depth at this rate, slowly enough to leave the pulse alone.
RETURN_PER_S: Final = 5.0
# Greatest speed of the contact's origin.
MOST_M_PER_S: Final = 20e-3
# The contact's origin keeps this distance from home, so that a withdrawal can leave the finger.
SPARE_M: Final = 1e-3


class YieldingTip:
    """Place of the contact under a finger that presses, and the speed by which the tip follows it.

    Parameters
    ----------
    press
        The finger's press, with the model of the tissue.
    law
        Contact of tip and finger.
    room_m
        Travel from first touch away from the finger.
    tick_s
        Time of a tick.

    Attributes
    ----------
    rendered_n
        The pulse: the loop's target without the part that belongs to the press.
    """

    def __init__(self, press: LocalPress, law: ContactLaw, room_m: float, tick_s: float) -> None:
        self._press, self._law, self._tick_s = press, law, tick_s
        self._room_m = max(0.0, room_m - SPARE_M)
        self._difference_n = math.nan
        # Place of the contact as the force loop has it.
        self._place_m = 0.0
        self._gain = self.rendered_n = 0.0

    def felt_n(self, film_n: float) -> float:
        """Return the felt force for the film's reading, which may lack the press."""
        return film_n + self._press.unseen_n

    def reading_n(self, felt_n: float) -> float:
        """Return the reading for the force loop: the pulse at the film on the wanted press."""
        static_n = self._press.static_n
        apart_n = felt_n - static_n
        if not math.isfinite(apart_n):
            return felt_n
        difference_n = apart_n - self.rendered_n
        if math.isnan(self._difference_n):
            self._difference_n = difference_n
        part = -math.expm1(-self._tick_s / (FORGET_S if self._press.still else MOVING_S))
        self._difference_n += (difference_n - self._difference_n) * part
        return self._gain * static_n + apart_n - self._difference_n

    def follow(self, target_n: float, gain: float, hardware: Hardware) -> float:
        """Advance by a tick, and move the contact's origin in the bench with the finger.

        target_n: target of the force loop. gain: factor of the press in it. Returns the speed in
        m/s to add to that of the force loop.
        """
        law, press, static_n = self._law, self._press, self._press.static_n
        wanted_static_n = gain * static_n
        self._gain, self.rendered_n = gain, target_n - wanted_static_n
        dented_m = law.position(static_n)
        yielded_m = min(press.yielded_m, max(0.0, self._room_m - dented_m))
        most_m = MOST_M_PER_S * self._tick_s
        step_m = -law.position(wanted_static_n) - yielded_m - self._place_m
        step_m = min(max(step_m, -most_m), most_m)
        self._place_m += step_m
        off_m = law.position(target_n) + self._place_m - hardware.position_m
        # The position at which the tip would touch the finger now.
        hardware.place_finger(-dented_m - yielded_m, press.unseen_n)
        speed_m_per_s = step_m / self._tick_s + RETURN_PER_S * off_m
        return min(max(speed_m_per_s, -MOST_M_PER_S), MOST_M_PER_S)
