"""Transit time: from an R wave of the heart to the arrival of its pulse, learnt from both. Pure.

It contains the time until the heart ejects, the way of the pulse wave to the sensor, and the delays
of both sensors: some 150 to 250 ms at the wrist. A constant shift of the ECG is part of it.
"""

import itertools
import statistics
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Bounds of a transit time in steps: 50 and 500 ms.
SHORTEST, LONGEST = 10, 100
# Number of the last arrivals whose transit times count, and the least number of them.
ARRIVALS, FEWEST = 9, 4
# Standard deviation over median absolute deviation, of a normal distribution.
NORMAL = 1.4826
# A pulse arrives on time within this number of deviations of the median, and within bounds in
# steps: 20 and 60 ms. The deviation is at least 1 ms.
DEVIATIONS, NEAR, FAR, LEAST = 4.0, 4.0, 12.0, 0.2
# An event is an arrival on time, an arrival without R wave, or an R wave without arrival. Of the
# last ones, so many of the last two kinds end reliability; it returns after a row without any.
EVENTS, WRONG = 5, 2
# R waves kept: those of 40 s at 4 beats a second.
KEPT = 160


@dataclass(slots=True)
class RWave:
    """An R wave: its position and the one at which it was found, in steps of the grid.

    transit: time in steps to the arrival of its pulse; None before.
    """

    at: float
    found: float
    transit: float | None = None


class TransitTime:
    """Transit time of one pulse, and whether R waves announce its beats. Positions are in steps.

    Attributes
    ----------
    median, deviation
        Transit time and its robust standard deviation in steps; None before enough arrivals.
    reliable
        Whether pulses follow R waves, and nothing else.
    waves
        R waves of the last 40 s, oldest first.
    """

    def __init__(self) -> None:
        self.waves: deque[RWave] = deque(maxlen=KEPT)
        self.median: float | None = None
        self.deviation = 0.0
        self.reliable = False
        self._transits: deque[float] = deque(maxlen=ARRIVALS)
        self._wrong: deque[bool] = deque([True] * EVENTS, maxlen=EVENTS)
        # R waves whose pulse may still arrive.
        self._expected: deque[RWave] = deque()
        self._analogues: tuple[float, NDArray[np.intp], NDArray[np.float64]] | None = None

    @property
    def tolerance(self) -> float:
        """Greatest difference from the median transit time of a pulse that is on time, in steps."""
        return min(max(DEVIATIONS * self.deviation, NEAR), FAR)

    @property
    def newest(self) -> float:
        """Position of the newest R wave, 0 before any."""
        return self.waves[-1].at if self.waves else 0.0

    def confirms(self, wave: RWave) -> bool:
        """Return whether a pulse arrived about the present transit time after an R wave."""
        if wave.transit is None or self.median is None:
            return False
        return abs(wave.transit - self.median) <= self.tolerance

    @property
    def analogues(self) -> tuple[float, NDArray[np.intp], NDArray[np.float64]]:
        """The newest R wave's position; lags of the R waves that pulses confirmed; their lengths.

        A length is the number of steps from an R wave to when the next one was found.
        """
        if self._analogues is None:
            newest = self.newest
            found = [
                (newest - wave.at, after.found - wave.at)
                for wave, after in itertools.pairwise(self.waves)
                if self.confirms(wave)
            ]
            lags, lengths = np.array(found).reshape(-1, 2).T
            self._analogues = newest, np.rint(lags).astype(np.intp), lengths
        return self._analogues

    def announce(self, at: float, found: float) -> None:
        """Take an R wave at a position, found at a later one."""
        wave = RWave(at, found)
        self._analogues = None
        self.waves.append(wave)
        self._expected.append(wave)

    def arrive(self, at: float) -> None:
        """Take the arrival of a pulse at a position."""
        before = (wave for wave in reversed(self.waves) if wave.at <= at - SHORTEST)
        wave = next(before, None)
        if wave is None or at - wave.at > LONGEST or wave.transit is not None:
            self._count(wrong=True)
            return
        wave.transit = at - wave.at
        on_time = self.confirms(wave)
        self._learn(wave.transit)
        # R waves expected before this one have no pulse.
        while self._expected and self._expected[0].at < wave.at:
            self._expected.popleft()
            self._count(wrong=True)
        if self._expected and self._expected[0] is wave:
            self._expected.popleft()
        self._count(wrong=not on_time)

    def advance(self, now: float) -> None:
        """Count the R waves whose pulse should have arrived before a position."""
        latest = LONGEST if self.median is None else self.median + self.tolerance
        while self._expected and now - self._expected[0].at > latest:
            self._count(wrong=True)
            self._expected.popleft()

    def _learn(self, transit: float) -> None:
        self._transits.append(transit)
        if len(self._transits) < FEWEST:
            return
        median = self.median = statistics.median(self._transits)
        absolute = statistics.median(abs(each - median) for each in self._transits)
        self.deviation = max(NORMAL * absolute, LEAST)

    def _count(self, wrong: bool) -> None:
        self._wrong.append(wrong)
        count = sum(self._wrong)
        self.reliable = count < WRONG if self.reliable else not count
