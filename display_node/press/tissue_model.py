"""The finger's local model of the wrist, learnt from what comes back. Pure.

Two laws: the pulse's height against the hold-down force, and the tissue's stiffness against it. The
finger meets these, never the delayed force itself (model-mediated teleoperation).
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.press.artery_fit import ArteryFit
from display_node.press.learnt_beats import BeatLevels
from protocol.tissue import StiffeningLaw
from protocol.wire.messages import LARGEST_N

# What height and foot deviate from the fitted law is the mean over the beats within this force,
# as if so many others did not deviate. Where the artery is wide, an error of 0.4 % in the height at
# one force is felt as 11 % at another, so single beats must not change the curve.
BEND_OVER_N, DOUBTED_BEATS = 0.1, 30.0
# Distance of the curve's points, and force over which a slope is taken.
GRID_N, BIN_N = 0.025, 0.05
LEAST_HEIGHT_N: Final = 1e-4
# A film whose zero is further from the foot than this many heights has not settled yet.
MOST_FOOT: Final = 2.0
Floats = NDArray[np.float64]
# The stiffness is learnt between answers whose hold-down differs by this much.
LEAST_CHANGE_N: Final = 0.1
SLOPE_ERROR, SLOPE_FORGET = 0.2, 0.002
SOFTEST, STIFFEST = 0.1, 10.0


class PulseCurve:
    """Height of the pulse, and level of its foot, against the hold-down force.

    Both are those of an artery's law, fitted to the beats, and what the beats deviate from it,
    where there were beats. Before learning, the height is that of a typical artery, 1 at best, and
    the foot is the film's zero.

    Parameters
    ----------
    most_n
        Largest hold-down force.

    Attributes
    ----------
    beats
        Number of beats that were learnt.
    best_height
        Largest height of the curve.
    law
        The fitted law.
    """

    def __init__(self, most_n: float) -> None:
        self._fit = ArteryFit()
        self._grid: Floats = np.linspace(0.0, most_n, math.ceil(most_n / GRID_N) + 1)
        self._step_n = float(self._grid[1])
        best = float(self._fit.law.heights(self._grid).max())
        self._fit.scale(-math.log(best))
        nothing = np.zeros(len(self._grid))
        self._correct(nothing, nothing)
        self.beats = 0

    def _correct(self, logs: Floats, levels: Floats) -> None:
        """Set the curves to the law's, and what heights and feet deviate from it."""
        self.law = self._fit.law
        heights = np.log(np.maximum(self.law.heights(self._grid), 1e-12)) + logs
        # As lists, whose items are quicker to read.
        self._heights: list[float] = heights.tolist()
        self._feet: list[float] = (self._fit.film(self._grid) + levels).tolist()
        self.best_height = math.exp(max(self._heights))

    def _at(self, values: list[float], force_n: float) -> float:
        """Return a curve's value at a force; beyond the grid, that of its end."""
        place = min(max(force_n / self._step_n, 0.0), len(values) - 1.0)
        at = min(int(place), len(values) - 2)
        low = values[at]
        return low + (place - at) * (values[at + 1] - low)

    def height(self, force_n: float) -> float:
        """Return the height at a hold-down force, in N once a beat was learnt."""
        return math.exp(self._at(self._heights, force_n))

    def foot(self, force_n: float) -> float:
        """Return the level of the foot relative to the height; negative below the film's zero."""
        return self._at(self._feet, force_n)

    def slope(self, force_n: float) -> float:
        """Return the height's change with the hold-down force, in N/N."""
        return (self.height(force_n + BIN_N) - self.height(force_n - BIN_N)) / (2 * BIN_N)

    def restart(self) -> None:
        """Begin with times that are unrelated to those before; what was learnt is kept."""
        self._fit.restart()

    def breath(self, time_s: float) -> float:
        """Return what respiration is expected to add to the relative pressure at a time."""
        wave = self._fit.respiration
        return 0.0 if wave is None else wave.ahead(time_s)

    def observe(self, beat: BeatLevels) -> None:
        """Take a beat, fit the law to it and those before, and find what they deviate from it."""
        height_n, force_n = beat.height_n, beat.hold_down_n
        if not LEAST_HEIGHT_N <= height_n <= LARGEST_N or not abs(force_n) <= LARGEST_N:
            return
        # Not by the largest: with a level that is no number, `max` depends on its place.
        if not all(abs(level_n) <= (MOST_FOOT + 1) * height_n for level_n in beat.levels_n):
            return
        if not math.isfinite(beat.at_s) or not 0 <= beat.moved_n <= LARGEST_N:
            return
        if self.beats == 0:
            # The unit of the heights is not known before.
            self._fit.scale(math.log(height_n / self.height(force_n)))
        self._fit.observe(beat)
        self.beats += 1
        forces = self._fit.beats["hold_down_n"]
        near = np.exp(-0.5 * ((self._grid[:, None] - forces) / BEND_OVER_N) ** 2)
        near /= near.sum(axis=1, keepdims=True) + DOUBTED_BEATS
        logs, levels = self._fit.residues
        self._correct(near @ logs, near @ levels)


class StiffnessFit:
    """The tissue's stiffening law, fitted to pairs of hold-down force and depth.

    dF/dz = (F + knee) / length is linear in F: its two coefficients, relative to a typical
    tissue's, are found by recursive least squares. No point of first touch is needed.
    """

    def __init__(self) -> None:
        self._typical = StiffeningLaw()
        self._ratios = np.ones(2)
        self._covariance = np.eye(2)
        self._last: tuple[float, float] | None = None
        self.law = self._typical

    def observe(self, force_n: float, depth_m: float) -> None:
        """Take a hold-down force and the probe's depth at the same time."""
        if force_n <= 0 or depth_m <= 0:
            self._last = None
            return
        last, typical = self._last, self._typical
        if last is None:
            self._last = force_n, depth_m
            return
        change_n, change_m = force_n - last[0], depth_m - last[1]
        if abs(change_n) < LEAST_CHANGE_N:
            return
        self._last = force_n, depth_m
        middle_n = 0.5 * (force_n + last[0])
        if change_m * change_n <= 0:
            return
        # Relative to the typical stiffness at this force, the error is about the same everywhere.
        whole = middle_n + typical.knee_n
        row = np.array([middle_n / whole, typical.knee_n / whole])
        seen = change_n / change_m / typical.stiffness_n_per_m(middle_n)
        if not SOFTEST <= seen <= STIFFEST:
            return
        self._covariance += SLOPE_FORGET * (np.eye(2) - self._covariance)
        gains = self._covariance @ row
        variance = float(row @ gains) + (SLOPE_ERROR * seen) ** 2
        self._ratios += gains * ((seen - float(row @ self._ratios)) / variance)
        self._covariance -= np.outer(gains, gains) / variance
        slope, touch = np.clip(self._ratios, SOFTEST, STIFFEST).tolist()
        # length = typical length / slope; knee / length = touch · typical stiffness at touch.
        length_m = typical.length_m / slope
        self.law = StiffeningLaw(touch * typical.stiffness_n_per_m(0.0) * length_m, length_m)
