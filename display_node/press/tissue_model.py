"""The finger's local model of the wrist, learnt from what comes back. Pure.

Two laws: the pulse's height against the hold-down force, and the tissue's stiffness against it. The
finger meets these, never the delayed force itself (model-mediated teleoperation).
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.press.artery_law import ArteryFit
from protocol.tissue import StiffeningLaw
from protocol.wire.messages import LARGEST_N

# Hold-down forces of a curve's points, and their distance over which a curve bends.
POINTS: Final = 25
REACH_N: Final = 0.4
# Deviation of ln(height) from the fitted law, and the force over which it changes. Error of one
# beat, and respiration's RMS of the arterial pressure, as a force.
BEND, BEND_OVER_N, BEAT_ERROR, BREATHING_N = 0.06, 0.15, 0.03, 0.03
# Distance of the curve's points; beats are gathered in parts of the force, and newer ones count for
# more where there are many.
GRID_N, BIN_N, MOST_BEATS = 0.025, 0.05, 10.0
# Deviation of the foot from the film's zero, relative to the height.
FOOT_LEVEL, FOOT_BEND, FOOT_ERROR, PEAK_ERROR = 0.2, 0.04, 0.005, 0.02
# Share of what is known that each beat forgets.
FORGET: Final = 0.0003
LEAST_HEIGHT_N: Final = 1e-4
# A film whose zero is further from the foot than this many heights has not settled yet.
MOST_FOOT: Final = 2.0
Floats = NDArray[np.float64]
# The stiffness is learnt between answers whose hold-down differs by this much.
LEAST_CHANGE_N: Final = 0.1
SLOPE_ERROR, SLOPE_FORGET = 0.2, 0.002
SOFTEST, STIFFEST = 0.1, 10.0


class LearntCurve:
    """A function of the hold-down force: a Gaussian process on a grid of forces.

    Parameters
    ----------
    step_n
        Distance of the grid's points, which begin at 0 N.
    typical
        Values before learning, one a point.
    level, bend
        Standard deviation from them: of all values together, and of single ones.
    error
        Standard deviation of an observation.
    """

    def __init__(
        self, step_n: float, typical: Floats, level: float, bend: float, error: float
    ) -> None:
        self._step_n, self._variance = step_n, error**2
        forces = step_n * np.arange(POINTS)
        apart = (forces[:, None] - forces[None, :]) / REACH_N
        self._covariance = level**2 + bend**2 * np.exp(-0.5 * apart**2)
        self._prior = self._covariance.copy()
        self._set(typical)

    def _set(self, values: Floats) -> None:
        # As a list too, whose items are quicker to read.
        self._values = values
        self._points: list[float] = values.tolist()

    def at(self, force_n: float) -> float:
        """Return the value at a force; beyond the grid, that of its end."""
        at, part = self._place(force_n)
        low = self._points[at]
        return low + part * (self._points[at + 1] - low)

    def observe(
        self, force_n: float, value: float, moved_n: float = 0.0, further: float = 0.0
    ) -> None:
        """Take an observation of the value at a force that moved by `moved_n` meanwhile.

        further: standard deviation besides that of every observation.
        """
        weights = self._weights(force_n)
        self._covariance += FORGET * (self._prior - self._covariance)
        gains = self._covariance @ weights
        slope = (self.at(force_n + moved_n) - self.at(force_n - moved_n)) / 2
        variance = float(weights @ gains) + self._variance + slope**2 + further**2
        error = value - float(weights @ self._values)
        self._set(self._values + gains * (error / variance))
        self._covariance -= np.outer(gains, gains) / variance

    def _place(self, force_n: float) -> tuple[int, float]:
        place = min(max(force_n / self._step_n, 0.0), POINTS - 1.0)
        at = min(int(place), POINTS - 2)
        return at, place - at

    def _weights(self, force_n: float) -> Floats:
        weights, (at, part) = np.zeros(POINTS), self._place(force_n)
        weights[at : at + 2] = 1 - part, part
        return weights


class PulseCurve:
    """Height of the pulse, and level of its foot, against the hold-down force.

    The height is that of an artery's law, fitted to the beats, times what they deviate from it,
    where there were beats. Before learning, it is that of a typical artery, 1 at best, and the foot
    is the film's zero.

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
        self._feet = LearntCurve(
            most_n / (POINTS - 1), np.zeros(POINTS), FOOT_LEVEL, FOOT_BEND, FOOT_ERROR
        )
        self._fit = ArteryFit()
        # Beats by hold-down: their number, and means of force and ln(height).
        bins = math.ceil(most_n / BIN_N) + 1
        self._counts: Floats = np.zeros(bins)
        self._forces: Floats = np.zeros(bins)
        self._logs: Floats = np.zeros(bins)
        self._grid: Floats = np.linspace(0.0, most_n, math.ceil(most_n / GRID_N) + 1)
        self._step_n = float(self._grid[1])
        best = float(self._fit.law.heights(self._grid).max())
        self._fit.scale(-math.log(best))
        self._correct(np.zeros(len(self._grid)))
        self.beats = 0

    def _correct(self, residues: Floats) -> None:
        """Set the curve to the law's, and what the logarithms of the heights deviate from it."""
        self.law = self._fit.law
        logs = np.log(np.maximum(self.law.heights(self._grid), 1e-12)) + residues
        self._heights: list[float] = logs.tolist()
        self.best_height = math.exp(max(self._heights))

    def height(self, force_n: float) -> float:
        """Return the height at a hold-down force, in N once a beat was learnt."""
        place = min(max(force_n / self._step_n, 0.0), len(self._heights) - 1.0)
        at = min(int(place), len(self._heights) - 2)
        low = self._heights[at]
        return math.exp(low + (place - at) * (self._heights[at + 1] - low))

    def foot(self, force_n: float) -> float:
        """Return the level of the foot relative to the height; negative below the film's zero."""
        return self._feet.at(force_n)

    def slope(self, force_n: float) -> float:
        """Return the height's change with the hold-down force, in N/N."""
        return (self.height(force_n + BIN_N) - self.height(force_n - BIN_N)) / (2 * BIN_N)

    def deviation(self, force_n: float) -> float:
        """Return the standard deviation of the height at a force by the law, as a share of it."""
        return float(self._fit.deviations(np.array([force_n]))[0])

    def observe(self, force_n: float, foot_n: float, height_n: float, moved_n: float = 0.0) -> None:
        """Take foot and height of a beat during which the hold-down force moved by `moved_n`."""
        if not LEAST_HEIGHT_N <= height_n <= LARGEST_N or not abs(force_n) <= LARGEST_N:
            return
        if not abs(foot_n) <= MOST_FOOT * height_n:
            return
        log = math.log(height_n)
        if self.beats == 0:
            # The unit of the heights is not known before.
            self._fit.scale(log - math.log(self.height(force_n)))
        peak_n = foot_n + height_n
        slope = (self.slope(force_n) / self.height(force_n)) * moved_n
        weight = BEAT_ERROR**2 / (BEAT_ERROR**2 + slope**2)
        at = min(max(round(force_n / BIN_N), 0), len(self._counts) - 1)
        self._counts *= 1 - FORGET
        count = min(float(self._counts[at]) + weight, MOST_BEATS)
        self._counts[at] = count
        self._forces[at] += (force_n - self._forces[at]) * weight / count
        self._logs[at] += (log - self._logs[at]) * weight / count
        self._learn()
        # Foot and peak both show the film's level. Respiration moves the foot less where the artery
        # is closed in diastole, and the peak less where it is wide in systole.
        breathing, height = BREATHING_N / self.law.pulse_n, self.height(force_n)
        for level_n, at, further in ((foot_n, 0, 0.0), (peak_n, 1, PEAK_ERROR)):
            moves = breathing * self.law.slope(at, force_n)
            self._feet.observe(force_n, level_n / height - at, moved_n, math.hypot(moves, further))
        self.beats += 1

    def _learn(self) -> None:
        """Fit the law to all beats, and find what they deviate from it."""
        seen = self._counts > 0
        counts: Floats = self._counts[seen]
        forces: Floats = self._forces[seen]
        logs: Floats = self._logs[seen]
        ahead, behind = (np.log(self.law.heights(forces + s)) for s in (GRID_N, -GRID_N))
        breathing = BREATHING_N * (ahead - behind) / (2 * GRID_N)
        variances = (BEAT_ERROR**2 + breathing**2) / counts
        self._fit.fit(forces, logs, variances + BEND**2)
        residues = logs - np.log(np.maximum(self._fit.law.heights(forces), 1e-12))
        covariance = _kernel(forces, forces) + np.diag(variances)
        self._correct(_kernel(self._grid, forces) @ np.linalg.solve(covariance, residues))


def _kernel(forces: Floats, others: Floats) -> Floats:
    return BEND**2 * np.exp(-0.5 * ((forces[:, None] - others[None, :]) / BEND_OVER_N) ** 2)


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
