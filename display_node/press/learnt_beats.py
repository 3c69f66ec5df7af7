"""Beats from which the artery's law is learnt: the newest of each hold-down force. Pure."""

import math
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
