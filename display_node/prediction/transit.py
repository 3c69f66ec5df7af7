"""Transit time: from an R wave of the heart to the arrival of its pulse, learnt from both. Pure.

It contains the time until the heart ejects, the way of the pulse wave to the sensor, and the delays
of both sensors: some 150 to 250 ms at the wrist. A constant shift of the ECG is part of it.
"""

import math
import statistics
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

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
# last ones, so many of the last two kinds end reliability. It returns after a row without any, at a
# deviation of at most 30 ms: beats of another heart pass the tolerance in a row, but drift.
EVENTS, WRONG, STEADY = 5, 2, 6.0
# A pause is certain after so many events in a row that were right: an ECG that is unplugged shows
# one as well, and beats of another heart are right for a while.
CERTAIN = 12
# Steps after an arrival in which the same beat goes on, 500 ms, and those from the foot of a pulse
# to its arrival, which is its steepest rise.
BEAT_STEPS, RISE_STEPS = 100.0, 10.0
# R-R intervals before an R wave that count, and the longest of them: 2 s.
INTERVALS, LONGEST_INTERVAL = 2, 400.0
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


class Analogues(NamedTuple):
    """R waves whose pulse came at the present transit time, oldest first, in steps.

    newest: position of the newest R wave. lags: from each R wave to it. lengths: from each to when
    the next one was found. intervals: differences of the last two R-R intervals before each from
    those before the newest one, the last first, shape (n, 2).
    """

    newest: float
    lags: NDArray[np.intp]
    lengths: NDArray[np.float64]
    intervals: NDArray[np.float64]


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
        self._arrived = -math.inf
        self._right = 0
        self._analogues: Analogues | None = None

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

    def pause(self, now: float) -> tuple[float, float]:
        """Return between which steps from a position on no pulse can rise.

        It begins when the last beat has passed, and ends with the earliest pulse of the next R
        wave: of one whose pulse is expected, or of one that has not been found yet. It has no
        length where R waves have not announced every one of the last pulses.
        """
        if self.median is None or self._right < CERTAIN:
            return 0.0, 0.0
        wave = self.waves[-1]
        first = self._expected[0].at if self._expected else now - (wave.found - wave.at)
        earliest = first + self.median - self.tolerance - RISE_STEPS
        return self._arrived + BEAT_STEPS - now, earliest - now

    @property
    def analogues(self) -> Analogues:
        """R waves with two R-R intervals before them that pulses confirmed."""
        if self._analogues is None:
            waves, newest = list(self.waves), self.newest
            places = [
                place for place in range(INTERVALS, len(waves) - 1) if self.confirms(waves[place])
            ]
            at = np.array([wave.at for wave in waves])
            before = np.minimum(np.diff(at), LONGEST_INTERVAL)
            following = np.array([waves[place + 1].found for place in places])
            of_each = np.array(places, np.intp)
            # The interval before wave i is the difference i − 1.
            intervals = [
                before[of_each - back] - before[-back] for back in range(1, INTERVALS + 1) if places
            ]
            self._analogues = Analogues(
                newest,
                np.rint(newest - at[of_each]).astype(np.intp),
                following - at[of_each],
                np.array(intervals).reshape(INTERVALS, -1).T,
            )
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
        self._arrived = at
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
        self._right = 0 if wrong else self._right + 1
        count = sum(self._wrong)
        steady = self.deviation <= STEADY
        self.reliable = count < WRONG if self.reliable else steady and not count
