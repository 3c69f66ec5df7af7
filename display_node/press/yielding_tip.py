"""The tip of a real bench under a finger that presses: it yields by the model of the tissue. Pure.

A hand keeps its force and follows the tip, so on a real bench a force loop alone does not fix the
tip's place: a target below the press lets the tip run away from the hand, one above it chases the
hand. Here the loop renders the pulse around the press, and the drive's position follows the model.
"""

import math
from typing import Final

from display_node.plant.contact import ContactLaw

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
    law
        Contact of tip and finger.
    room_m
        Travel from first touch away from the finger.
    tick_s
        Time of a tick.

    Attributes
    ----------
    origin_m
        Position at which the tip would touch the finger now, at most 0.
    speed_m_per_s
        Speed to add to that of the force loop.
    """

    def __init__(self, law: ContactLaw, room_m: float, tick_s: float) -> None:
        self._law, self._tick_s = law, tick_s
        self._room_m = max(0.0, room_m - SPARE_M)
        self._difference_n = math.nan
        # Place of the contact as the force loop has it.
        self._place_m = 0.0
        self.origin_m = self.speed_m_per_s = 0.0

    def reading_n(
        self,
        felt_n: float,
        static_n: float,
        wanted_static_n: float,
        rendered_n: float,
        still: bool,
    ) -> float:
        """Return the reading for the force loop: the pulse at the film on the wanted press.

        Parameters
        ----------
        felt_n
            Felt force.
        static_n, wanted_static_n
            The finger's press, and the part of the loop's target that belongs to it.
        rendered_n
            The rest of the target.
        still
            Whether the press is constant.
        """
        apart_n = felt_n - static_n
        if not math.isfinite(apart_n):
            return felt_n
        difference_n = apart_n - rendered_n
        if math.isnan(self._difference_n):
            self._difference_n = difference_n
        part = -math.expm1(-self._tick_s / (FORGET_S if still else MOVING_S))
        self._difference_n += (difference_n - self._difference_n) * part
        return wanted_static_n + apart_n - self._difference_n

    def follow(
        self,
        static_n: float,
        wanted_static_n: float,
        wanted_n: float,
        yielded_m: float,
        position_m: float,
    ) -> None:
        """Advance by a tick, and compute place and speed.

        Parameters
        ----------
        static_n, wanted_static_n, wanted_n
            The finger's press, its part of the loop's target, and the target.
        yielded_m
            Depth by which the model of the tissue yields.
        position_m
            Position of the drive from first touch.
        """
        law, dented_m = self._law, self._law.position(static_n)
        yielded_m = min(yielded_m, max(0.0, self._room_m - dented_m))
        self.origin_m = -dented_m - yielded_m
        most_m = MOST_M_PER_S * self._tick_s
        step_m = -law.position(wanted_static_n) - yielded_m - self._place_m
        step_m = min(max(step_m, -most_m), most_m)
        self._place_m += step_m
        off_m = law.position(wanted_n) + self._place_m - position_m
        speed_m_per_s = step_m / self._tick_s + RETURN_PER_S * off_m
        self.speed_m_per_s = min(max(speed_m_per_s, -MOST_M_PER_S), MOST_M_PER_S)
