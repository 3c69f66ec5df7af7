"""Artefacts: values far outside the pulse's range, from which no predictor should learn. Pure.

A hand that moves, or a sensor that is touched, moves the force by several times the pulse's height.
Weights that were fitted to that predict worse for their whole memory, tens of seconds.
"""

import math

from display_node.prediction.history import RECENT, History

# The range is that of recent values without the last 250 ms. It is computed anew every 50 ms.
LATELY, REVIEWED = 50, 10
# It shrinks by this share of the difference each time, in a minute to a third: a pulse that returns
# after a pause is no artefact.
SHRINKS = 1 / 1_200
# Fewer values, 2.5 s, may not contain a whole beat.
FEWEST = 500
# Filters have the last value outside of the range among their inputs for 1.3 s.
HELD = 260
# After 5 s it is no artefact: the pulse has changed.
LONGEST = 1_000


class ArtefactDetector:
    """Detector of values that are outside the pulse's recent range, and of the time after them.

    present: whether the newest value is that of an artefact, or follows one.
    """

    def __init__(self) -> None:
        self._low, self._high = -math.inf, math.inf
        self._begun = self._ends = 0
        self.present = False

    def observe(self, history: History) -> None:
        """Take the newest value; call it once after each push."""
        count = history.count
        if not self._low <= history.newest <= self._high:
            if count >= self._ends:
                self._begun = count
            self._ends = count + HELD
        self.present = count < self._ends and count - self._begun <= LONGEST
        # Values of an artefact do not count, unless it was none.
        known = min(count - (self._ends if count >= self._ends else self._begun), RECENT)
        if not self.present and count % REVIEWED == 0 and known >= FEWEST:
            self._review(*history.bounds(known, LATELY))

    def _review(self, low: float, high: float) -> None:
        if self._high < math.inf:
            low = min(low, self._low + SHRINKS * (low - self._low))
            high = max(high, self._high - SHRINKS * (self._high - high))
        self._low, self._high = low, high
