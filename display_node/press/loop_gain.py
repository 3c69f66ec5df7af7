"""Gain of the loop through the network: measured live, and bounded. Pure."""

import math
from typing import Final

# Below 1 no delay can make the loop swing; below 0.1 what goes round is not noticed.
MOST_GAIN: Final = 0.08
# Time over which the gain is the largest one.
GAIN_S: Final = 5.0


class LoopGain:
    """Gain of the loop through the network, as an upper bound, and the set-point that keeps it low.

    A newton of hold-down changes the pulse's height by the slope of the height curve. Of a pulse,
    the share that is not subtracted from the reading goes on to the set-point, as far as an average
    and the hand let it through.

    While the product would be above `MOST_GAIN`, the set-point follows the press only by such a
    share that it is not: from the set-point at which it was lower, which does not depend on the
    pulse since.

    Attributes
    ----------
    gain
        The largest gain of the last seconds.
    """

    def __init__(self) -> None:
        self.gain = 0.0
        self._share = 1.0
        self._anchor_n = 0.0

    def add(self, remaining: float, through: float, slope: float, elapsed_s: float) -> None:
        """Take what the loop's gain consists of.

        Parameters
        ----------
        remaining
            Share of the pulse that remains in the reading.
        through
            Change of the set-point, over the height of a pulse in the reading.
        slope
            Change of the height with the hold-down, in N/N.
        elapsed_s
            Time since the last call.
        """
        free = remaining * abs(through) * abs(slope)
        self._share = 1.0 if free <= MOST_GAIN else MOST_GAIN / free
        now = self._share * free
        self.gain = max(now, math.exp(-elapsed_s / GAIN_S) * self.gain)

    def bound(self, wanted_n: float) -> float:
        """Return the set-point for a press, with a gain of at most `MOST_GAIN`."""
        if self._share == 1.0:
            self._anchor_n = wanted_n
            return wanted_n
        return self._anchor_n + self._share * (wanted_n - self._anchor_n)
