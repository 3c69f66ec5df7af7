"""Beats from which the artery's law is learnt: their levels, and the newest of each force. Pure."""

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.press.respiration import FITTED_S, WAVE, FittedWave

Floats = NDArray[np.float64]
# Beats are kept by hold-down: the newest of each part of the force, and not more than MOST_BEATS.
BIN_N, OF_A_BIN, MOST_BEATS = 0.05, 5, 64
# Expected respiration of a beat before a wave is known: none, without drift, and its deviation.
NO_WAVE: Final = (0.0, 0.0, WAVE)


class BeatLevels(NamedTuple):
    """One beat at a steady hold-down.

    Attributes
    ----------
    at_s, rise_s
        Time of the peak, and time from the foot to it.
    hold_down_n, moved_n
        Mean of the hold-down, and its largest distance from it.
    levels_n
        The film's foot, three quartiles of the time about the peak, and peak.
    """

    at_s: float
    rise_s: float
    hold_down_n: float
    moved_n: float
    levels_n: tuple[float, float, float, float, float]

    @property
    def height_n(self) -> float:
        """Peak above foot."""
        return self.levels_n[-1] - self.levels_n[0]


# Columns of the beats that are kept: those of `BeatLevels`, the age in beats, and the fitted
# respiratory pressure over the pulse pressure. By the wave: what that should be, its drift from the
# peak to the foot, and its deviation.
BEAT: Final = np.dtype(
    [
        ("at_s", float),
        ("rise_s", float),
        ("hold_down_n", float),
        ("moved_n", float),
        ("levels_n", float, 5),
        ("age_beats", float),
        ("respiration", float),
        ("expected", float),
        ("drift", float),
        ("deviation", float),
    ]
)


class BeatMemory:
    """The newest beats of each hold-down, and the respiratory pressure of each.

    Attributes
    ----------
    rows
        One row a beat, oldest first, of type `BEAT`. `respiration` and its expectation by the wave
        may be written.
    """

    def __init__(self) -> None:
        self.rows: NDArray[np.void] = np.zeros(0, BEAT)

    def __getitem__(self, column: str) -> Floats:
        """Return a column of `BEAT`, one value or row of values a beat."""
        values: Floats = self.rows[column]
        return values

    def add(self, beat: BeatLevels) -> None:
        """Add a beat; the oldest one of a hold-down is forgotten where there are many."""
        bins = np.rint(self["hold_down_n"] / BIN_N)
        same = np.flatnonzero(bins == round(beat.hold_down_n / BIN_N))
        if len(same) >= OF_A_BIN:
            self.rows = np.delete(self.rows, same[0], 0)
        elif len(bins) >= MOST_BEATS:
            _, of_bin, counts = np.unique(bins, return_inverse=True, return_counts=True)
            self.rows = np.delete(self.rows, np.argmax(of_bin == counts.argmax()), 0)
        self["age_beats"][:] += 1.0
        row = np.array((*beat, 0.0, 0.0, *NO_WAVE), BEAT)
        self.rows = np.append(self.rows, row)

    def restart(self) -> None:
        """Begin with times that are unrelated to those before."""
        self["at_s"][:] = -math.inf

    def expect(self, wave: FittedWave) -> None:
        """Expect a wave in the newest beats, and begin with it in the last one."""
        times_s = self["at_s"]
        recent = times_s > times_s[-1] - FITTED_S
        at = wave.at(times_s[recent])
        self["expected"][recent] = at
        self["drift"][recent] = wave.at(times_s[recent] - self["rise_s"][recent]) - at
        self["deviation"][recent] = wave.deviation
        self["respiration"][-1] = at[-1]

    def expect_none(self) -> None:
        """Expect of no beat any respiration."""
        self["expected"][:], self["drift"][:], self["deviation"][:] = NO_WAVE


# Levels are taken of a beat in which the hold-down stays within this share and force.
STEADY_SHARE, STEADY_N = 0.04, 0.01
# Time before and after the peak of which the quartiles are taken. It does not depend on the
# interval of the beat, which varies more than the time of systole.
AROUND_NS: Final = 200_000_000
# Frames of which a foot is the mean.
FOOT: Final = 5


class PulseHeight:
    """Levels of each beat at a steady hold-down: foot, three quartiles, and peak.

    A peak is the highest value within half a beat before and after it. The foot is the lowest one
    before it: it belongs to the same upstroke, so a respiratory wave changes both alike.
    """

    def __init__(self) -> None:
        self._means: deque[tuple[int, float, float]] = deque()

    def add(
        self, hold_down_n: float, pulse_n: float, now_ns: int, beat_ns: int
    ) -> BeatLevels | None:
        """Take a frame's means; return the levels of a beat that is complete, or None.

        Parameters
        ----------
        hold_down_n, pulse_n
            Means of the hold-down and of the film.
        now_ns
            Time of the frame.
        beat_ns
            Usual time of a beat.
        """
        means = self._means
        if means and now_ns - means[-1][0] > beat_ns // 8:
            means.clear()
        means.append((now_ns, hold_down_n, pulse_n))
        while now_ns - means[0][0] > beat_ns:
            means.popleft()
        if now_ns - means[0][0] < beat_ns - beat_ns // 16:
            return None
        at = len(means) // 2
        pulses_n = [each[2] for each in means]
        high_n = pulses_n[at]
        if high_n <= max(*pulses_n[:at], *pulses_n[at + 1 :]):
            return None
        mean_n = sum(each[1] for each in means) / len(means)
        moved_n = max(abs(each[1] - mean_n) for each in means)
        if moved_n > STEADY_SHARE * abs(mean_n) + STEADY_N:
            return None
        peak_ns = means[at][0]
        around = sorted(each[2] for each in means if abs(each[0] - peak_ns) < AROUND_NS)
        # The lowest of many values would be that of the noise, where the foot is flat.
        sums = [sum(pulses_n[first : first + FOOT]) for first in range(at - FOOT + 1)]
        low_n = min(sums) / FOOT
        low_ns = means[sums.index(min(sums)) + FOOT // 2][0]
        first, second, third = (around[len(around) * part // 4] for part in (1, 2, 3))
        levels_n = low_n, first, second, third, high_n
        return BeatLevels(peak_ns * 1e-9, (peak_ns - low_ns) * 1e-9, mean_n, moved_n, levels_n)
