"""Holding time of a command on a host that stalls, and the speed that a stepper may press at then.

A drive goes on as it was told last, until it is told again. A command meant for a tick that is held
for many leads too far by all of them: a loop whose gain is made for a tick swings up, and what is
made up for at once is overdone. So a command is made for as long as commands are held lately, and
must not press too hard if it is held for as long as the worst of them. Pure.
"""

import math

from display_node.plant.contact import ContactLaw

# How long the usual hold, and how long the worst stall and the peak of the force are remembered:
# what is left of each after so long is 1/e.
USUAL_S = 0.1
WORST_S = 10.0
# What a stall may press with, over the highest force that was wanted lately.
HEADROOM = 1.25


class StallGuard:
    """Remembers the stalls and the forces of late.

    play_m: how much further than the tip the screw may have to go, to take up its play.
    peak_n: the highest force that was wanted lately.
    held_s: how long the command is held that an instant of late has met, on average; a tick where
    the host keeps its time.
    """

    def __init__(self, law: ContactLaw, tick_s: float, play_m: float) -> None:
        self._law = law
        self._tick_s = tick_s
        self._play_m = play_m
        self._usual = math.exp(-tick_s / USUAL_S)
        self._worst = math.exp(-tick_s / WORST_S)
        # Sums of the holds and of their squares, in ticks, of which old ones count less.
        self._holds = self._squares = 1 / (1 - self._usual)
        self._longest_s = 0.0
        self.peak_n = 0.0
        self.held_s = tick_s

    def tick(self, missed_ticks: int, wanted_n: float) -> None:
        """Advance one tick, with how many were missed before it and what the finger is to feel
        now."""
        self.peak_n = max(wanted_n, self._worst * self.peak_n)
        if not (missed_ticks or self._longest_s):
            return
        hold = missed_ticks + 1
        self._longest_s *= self._worst
        if missed_ticks:
            self._longest_s = max(self._longest_s, hold * self._tick_s)
        self._holds = self._usual * self._holds + hold
        self._squares = self._usual * self._squares + hold * hold
        self.held_s = self._tick_s * self._squares / self._holds

    @property
    def limiting(self) -> bool:
        """True while the host has stalled lately."""
        return self._longest_s >= 2 * self._tick_s

    def fastest(self, screw_m: float) -> float:
        """While it is wary, the highest speed in m/s towards the finger for a screw there."""
        furthest_m = self._law.position(HEADROOM * self.peak_n) + self._play_m
        return max(0.0, furthest_m - screw_m) / self._longest_s
