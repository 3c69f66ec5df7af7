"""The finger's local model of the wrist, learnt from what comes back. Pure.

Two laws: the pulse's height against the hold-down force, and the tissue's stiffness against it. The
finger meets these, never the delayed force itself (model-mediated teleoperation).
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.tissue import StiffeningLaw, TubeLaw
from protocol.wire.messages import LARGEST_N

# Hold-down forces of a curve's points, and their distance over which a curve bends.
POINTS: Final = 25
REACH_N: Final = 0.4
# Deviation of ln(height) from the typical curve, before anything is learnt: of all heights
# together, and of single ones. Error of one beat's, by respiration and noise.
LEVEL, BEND, BEAT_ERROR = 2.0, 1.5, 0.05
# The same of the foot, relative to the height.
FOOT_LEVEL, FOOT_BEND, FOOT_ERROR = 0.2, 0.2, 0.03
# Share of what is known that each beat forgets.
FORGET: Final = 0.0003
# Mean arterial pressure and pulse pressure of a typical wrist under the probe, as forces.
TYPICAL_MEAN_N, TYPICAL_PULSE_N, TYPICAL_MEAN_SHARE = 1.2, 0.52, 0.27
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

    @property
    def highest(self) -> float:
        """The largest value."""
        return max(self._points)

    def shift(self, change: float) -> None:
        """Add a number to all values."""
        self._set(self._values + change)

    def at(self, force_n: float) -> float:
        """Return the value at a force; beyond the grid, that of its end."""
        at, part = self._place(force_n)
        low = self._points[at]
        return low + part * (self._points[at + 1] - low)

    def deviation(self, force_n: float) -> float:
        """Return the standard deviation of the value at a force."""
        weights = self._weights(force_n)
        return math.sqrt(max(0.0, float(weights @ self._covariance @ weights)))

    def observe(self, force_n: float, value: float, moved_n: float = 0.0) -> None:
        """Take an observation of the value at a force that moved by `moved_n` meanwhile."""
        weights = self._weights(force_n)
        self._covariance += FORGET * (self._prior - self._covariance)
        gains = self._covariance @ weights
        slope = (self.at(force_n + moved_n) - self.at(force_n - moved_n)) / 2
        variance = float(weights @ gains) + self._variance + slope**2
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

    Before learning, the height is that of a typical artery by its tube law, 1 at best, and the
    foot is the film's zero.

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
    """

    def __init__(self, most_n: float) -> None:
        self._step_n = step_n = most_n / (POINTS - 1)
        # One newton of hold-down is 10 kPa at the artery, that of a probe of 1 cm².
        tube = TubeLaw.highest_at_mean(TYPICAL_MEAN_SHARE)
        mean_pa = 1e4 * TYPICAL_MEAN_N
        low_pa = mean_pa - 1e4 * TYPICAL_MEAN_SHARE * TYPICAL_PULSE_N
        outside = (1e4 * step_n * np.arange(POINTS)).tolist()
        high_pa = low_pa + 1e4 * TYPICAL_PULSE_N
        heights = np.array([tube.height(each, low_pa, high_pa) for each in outside])
        logs = np.log(heights / heights.max())
        self._logs = LearntCurve(step_n, logs, LEVEL, BEND, BEAT_ERROR)
        self._feet = LearntCurve(step_n, np.zeros(POINTS), FOOT_LEVEL, FOOT_BEND, FOOT_ERROR)
        self.beats = 0
        self.best_height = 1.0

    def height(self, force_n: float) -> float:
        """Return the height at a hold-down force, in N once a beat was learnt."""
        return math.exp(self._logs.at(force_n))

    def foot(self, force_n: float) -> float:
        """Return the level of the foot relative to the height; negative below the film's zero."""
        return self._feet.at(force_n)

    def slope(self, force_n: float) -> float:
        """Return the height's change with the hold-down force, in N/N."""
        step_n = self._step_n
        return (self.height(force_n + step_n) - self.height(force_n - step_n)) / (2 * step_n)

    def deviation(self, force_n: float) -> float:
        """Return the standard deviation of the height at a force, as a share of it."""
        return self._logs.deviation(force_n)

    def observe(self, force_n: float, foot_n: float, height_n: float, moved_n: float = 0.0) -> None:
        """Take foot and height of a beat during which the hold-down force moved by `moved_n`."""
        if not LEAST_HEIGHT_N <= height_n <= LARGEST_N or not abs(force_n) <= LARGEST_N:
            return
        if not abs(foot_n) <= MOST_FOOT * height_n:
            return
        log = math.log(height_n)
        if self.beats == 0:
            # The unit of the heights is not known before.
            self._logs.shift(log - self._logs.at(force_n))
        self._logs.observe(force_n, log, moved_n)
        self._feet.observe(force_n, foot_n / height_n, moved_n)
        self.best_height = math.exp(self._logs.highest)
        self.beats += 1


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
