"""Detector of a pulse's beats from the rise and level at each step of 5 ms. Pure.

A beat is found where the pulse rises far, and to a high level, compared with the last seconds. A
second wave within the same beat rises as far at most to half the level.
"""

import math
from collections import deque

# A beat lasts at most 3 s: 20 beats a minute, and 2 % below. Longer and shorter ones are found
# down to 10 and up to 660 a minute, so that a rate beyond the range is not taken for half of it.
LONGEST = 612
FEWEST, MOST = 18, 1_200
# Time within which a rise is measured.
RISE = 50
# A rise is over where it falls below this share of the highest ones.
OVER_SHARE = 0.2
# Before a rhythm is known, a rise must have this share of the highest ones.
FIRST_SHARE = 0.6
# Afterwards, the share that is required falls between these two parts of a usual interval: until
# then, a rise is more likely a second wave; later, an early beat that may be weak.
EARLY_SHARE, LATE_SHARE = 0.6, 0.33
EARLY, LATE = 0.5, 0.63
INTERVALS = 8
# Beats are searched after this time.
LEARNT = 250
# Levels are within the range of the last 2.5 s, which is kept as that of blocks of 0.25 s.
BLOCK, BLOCKS = 50, 10
# The highest rise is that of this time, or of the usual interval and a quarter.
WINDOW = 500


class RecentRange:
    """Lowest and highest value of the last 2.5 s."""

    def __init__(self) -> None:
        self._lows: deque[float] = deque([math.inf], maxlen=BLOCKS)
        self._highs: deque[float] = deque([-math.inf], maxlen=BLOCKS)
        self._count = 0

    def level(self, value: float) -> float:
        """Add a value; return its level from 0, the lowest, to 1, the highest."""
        lows, highs = self._lows, self._highs
        if self._count == BLOCK:
            self._count = 0
            lows.append(value)
            highs.append(value)
        self._count += 1
        lows[-1], highs[-1] = min(lows[-1], value), max(highs[-1], value)
        low, high = min(lows), max(highs)
        return (value - low) / (high - low) if high > low else 0.0


class RiseDetector:
    """Detector of beats, step by step."""

    def __init__(self) -> None:
        self._range = RecentRange()
        # Highest rises of the last windows, of which each contains a beat. The least of them
        # counts: the others may contain artefacts.
        self._highest: deque[float] = deque(maxlen=3)
        self._window_highest, self._window_end = 0.0, LONGEST
        self._intervals: deque[int] = deque(maxlen=INTERVALS)
        self._usual: int | None = None
        # The last beat, the last strong one, and the greatest score of the present rise.
        self._last: int | None = None
        self._strong: int | None = None
        self._rising, self._greatest = False, 0.0

    def begins_beat(self, step: int, rise: float, force_n: float) -> bool:
        """Return whether a beat rises at this step.

        Parameters
        ----------
        step
            Number of the step.
        rise
            Rise of the pulse within the last 250 ms.
        force_n
            Force at this step.
        """
        score = rise * self._range.level(force_n)
        self._window_highest = max(self._window_highest, rise)
        if step >= self._window_end:
            self._highest.append(self._window_highest)
            # A window contains a beat of a slow rhythm, too.
            length = LONGEST if self._usual is None else max(WINDOW, 5 * self._usual // 4)
            self._window_highest, self._window_end = 0.0, step + length
        if step < LEARNT:
            return False
        least = min(self._highest) if self._highest else self._window_highest
        if self._rising:
            self._greatest = max(self._greatest, score)
            self._rising = score > OVER_SHARE * least
            if not self._rising and self._greatest > FIRST_SHARE * least:
                self._add_interval()
            return False
        if score <= LATE_SHARE * least or score <= self._share(step) * least:
            return False
        self._rising, self._greatest = True, score
        if self._last is not None and step - self._last < max(FEWEST, (self._usual or 0) // 3):
            return False
        self._last = step
        return True

    def _add_interval(self) -> None:
        """Add the interval between strong beats; a weak one may be a second wave."""
        before, self._strong = self._strong, self._last
        if before is None or self._last is None or before == self._last:
            return
        if self._last - before <= MOST:
            self._intervals.append(self._last - before)
        else:
            self._intervals.clear()
        intervals = sorted(self._intervals)
        self._usual = intervals[len(intervals) // 2] if len(intervals) > 1 else None

    def _share(self, step: int) -> float:
        if self._last is None or self._usual is None:
            return FIRST_SHARE
        passed = ((step - self._last) / self._usual - EARLY) / (LATE - EARLY)
        return EARLY_SHARE + (LATE_SHARE - EARLY_SHARE) * min(max(passed, 0.0), 1.0)
