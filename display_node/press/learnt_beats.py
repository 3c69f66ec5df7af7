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


class BeatMemory:
    """The newest beats of each hold-down, and the respiratory pressure of each.

    Attributes
    ----------
    rows
        One row a beat: time, rise, hold-down, motion, age in beats, its five levels, and its
        respiratory pressure; of that, the expectation, its drift to the foot, and its deviation.
    """

    def __init__(self) -> None:
        self.rows: Floats = np.zeros((0, 14))

    @property
    def times_s(self) -> Floats:
        """Time of each beat's peak."""
        times_s: Floats = self.rows[:, 0]
        return times_s

    @property
    def forces_n(self) -> Floats:
        """Hold-down of each beat."""
        forces_n: Floats = self.rows[:, 2]
        return forces_n

    @property
    def levels_n(self) -> Floats:
        """Levels of each beat."""
        levels_n: Floats = self.rows[:, 5:10]
        return levels_n

    @property
    def breath(self) -> Floats:
        """Fitted respiratory pressure of each beat over the pulse pressure; it may be written."""
        breath: Floats = self.rows[:, 10]
        return breath

    @property
    def wave(self) -> Floats:
        """Expectation of it by the wave, drift to the foot, and deviation; it may be written."""
        wave: Floats = self.rows[:, 11:]
        return wave

    def add(self, beat: BeatLevels) -> None:
        """Add a beat; the oldest one of a hold-down is forgotten where there are many."""
        bins = np.rint(self.forces_n / BIN_N)
        same = np.flatnonzero(bins == round(beat.hold_down_n / BIN_N))
        if len(same) >= OF_A_BIN:
            self.rows = np.delete(self.rows, same[0], 0)
        elif len(bins) >= MOST_BEATS:
            _, of_bin, counts = np.unique(bins, return_inverse=True, return_counts=True)
            self.rows = np.delete(self.rows, np.argmax(of_bin == counts.argmax()), 0)
        self.rows[:, 4] += 1.0
        row = (*beat[:4], 0.0, *beat.levels_n, 0.0, *NO_WAVE)
        self.rows = np.vstack([self.rows, row])

    def restart(self) -> None:
        """Begin with times that are unrelated to those before."""
        self.rows[:, 0] = -math.inf

    def expect(self, wave: FittedWave) -> None:
        """Expect a wave in the newest beats, and begin with it in the last one."""
        recent = self.times_s > self.times_s[-1] - FITTED_S
        times_s, rises_s = self.times_s[recent], self.rows[recent, 1]
        at = wave.at(times_s)
        drift = wave.at(times_s - rises_s) - at
        self.wave[recent] = np.stack([at, drift, np.full(len(at), wave.deviation)], axis=1)
        self.breath[-1] = at[-1]


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
