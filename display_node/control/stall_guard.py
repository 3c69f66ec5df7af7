"""Holding time of a command on a host that stalls, and the speed at which a stepper may press then.

A drive keeps its last command until the next. A command for one tick that is held for many leads
too far: a loop whose gain is designed for a tick swings up, and a correction for one tick
overshoots. So each command is computed for the usual holding time of late, and must not press too
hard if it is held for the worst of them (decision 25).
"""

import math

from display_node.plant.contact import ContactLaw

# Time constants by which the usual holding time, and the worst stall and the force's peak, decay.
USUAL_S = 0.1
WORST_S = 10.0
# Force during a stall, as a multiple of the highest force that was wanted lately.
HEADROOM = 1.25


class StallGuard:
    """Memory of recent stalls and forces.

    Parameters
    ----------
    play_m
        Travel of the screw in m beyond the tip's, to take up its backlash.

    Attributes
    ----------
    peak_n
        Highest force in N that was wanted lately.
    held_s
        Mean holding time in s of the commands that recent instants have met; a tick where the host
        keeps its time.
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
        """Advance one tick, after missed ones, towards a wanted force in N."""
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
        """True where the host has stalled lately, so that the speed is limited."""
        return self._longest_s >= 2 * self._tick_s

    def fastest(self, screw_m: float) -> float:
        """Return the highest speed towards the finger in m/s, for the screw's position in m."""
        furthest_m = self._law.position(HEADROOM * self.peak_n) + self._play_m
        return max(0.0, furthest_m - screw_m) / self._longest_s
