"""The pulse against the hold-down force: its curve, the best force, and a person's three levels.

Beats at many hold-down forces give the curve of the height's logarithm by Gaussian process
regression (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, chapters 2 and
5). Outliers count less, as with errors of Student's t distribution. Pure.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import GOOD
from protocol.errors import DepthError

Floats = NDArray[np.float64]
# Fewest good beats, and fewest hold-down forces that differ by more than APART_N.
FEWEST_BEATS, FEWEST_FORCES, APART_N = 12, 4, 0.04
# Points of the curve.
POINTS: Final = 601
# Deviations of the logarithm from a parabola, distances in N over which they change, and relative
# errors of a beat's height. Heights of a tenth of the largest one have 1.4 times the error.
BENDS: Final = (0.3, 1.0)
REACHES_N: Final = (0.2, 0.3, 0.45, 0.7)
ERRORS: Final = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1)
SMALL: Final = 0.1
# Degrees of freedom of the errors, and rounds in which outliers lose their weight.
FREEDOM, ROUNDS = 4.0, 4
# Heights within this share of the largest one are as large. So the best force is the lower one
# where the curve is flat; where it is not, this puts it some 1.5 % lower.
FLAT: Final = 0.001
# Light and deepest: where the height is this share of the largest one, before and after it.
LEVEL_SHARE: Final = 0.5
DRAWS: Final = 200
# Heights count as this share of the largest one at least.
LEAST: Final = 1e-3


class BeatPoint(NamedTuple):
    """One beat at a hold-down force.

    Attributes
    ----------
    hold_down_n, height_n
        Mean hold-down force over the beat, and force from its foot to its peak.
    mean
        Mean of the pulse above its foot, as a share of the height.
    upstroke, notch
        Times from the onset to the peak and to the dicrotic notch, as shares of the beat; NaN
        without a notch.
    flat
        Share of the beat within a tenth of its height above the foot. It grows where the artery is
        closed in diastole.
    quality
        0 to 1; below `GOOD` the beat is not used.
    """

    hold_down_n: float
    height_n: float
    mean: float
    upstroke: float
    notch: float
    flat: float
    quality: float


class Estimate(NamedTuple):
    """A value and its standard deviation."""

    value: float
    deviation: float


@dataclass(frozen=True, slots=True)
class DepthCurve:
    """The pulse's height against the hold-down force, from the least to the greatest one.

    Attributes
    ----------
    points
        All beats.
    force_n, height_n, deviation_n
        The curve and its standard deviation.
    best_n
        Hold-down force of the largest height; where the curve is flat, the lowest such force.
    largest_n
        The largest height.
    light_n, deepest_n
        Forces below and above the best one at which the height is `LEVEL_SHARE` of the largest;
        None where the curve does not get there.
    """

    points: Sequence[BeatPoint]
    force_n: Floats
    height_n: Floats
    deviation_n: Floats
    best_n: Estimate
    largest_n: Estimate
    light_n: Estimate | None
    deepest_n: Estimate | None

    @property
    def good(self) -> list[BeatPoint]:
        """The beats of good quality."""
        return [point for point in self.points if point.quality >= GOOD]

    @property
    def at_end(self) -> str | None:
        """Return what is missing if the largest height is at an end of the curve."""
        if self.best_n.value >= self.force_n[-1]:
            return "the pulse still grew at the greatest hold-down: press harder"
        if self.best_n.value <= self.force_n[0]:
            return "the pulse was highest at the least hold-down: begin more lightly"
        return None

    def levels(self) -> dict[str, Estimate | None]:
        """Return the hold-down of the three levels of this person, by name."""
        return {"light": self.light_n, "deeper": self.best_n, "deepest": self.deepest_n}


def fit_depth_curve(points: Sequence[BeatPoint]) -> DepthCurve:
    """Fit the curve to beats at several hold-down forces.

    Raises
    ------
    DepthError
        Too few beats are good, or their hold-down forces are too similar.
    """
    good = [point for point in points if point.quality >= GOOD]
    forces = np.array([point.hold_down_n for point in good])
    heights = np.array([point.height_n for point in good])
    distinct = 1 + int((np.diff(np.sort(forces)) > APART_N).sum()) if good else 0
    if len(good) < FEWEST_BEATS or (
        distinct < FEWEST_FORCES and np.ptp(forces) < FEWEST_FORCES * 2 * APART_N
    ):
        raise DepthError(
            f"too few beats for a curve: {len(good)} good of {len(points)}, at {distinct} hold-down"
            f" forces; at least {FEWEST_BEATS} at {FEWEST_FORCES} are needed: check the sensor's"
            " place, and sweep over a wider range or for longer"
        )
    scale_n = float(np.quantile(heights, 0.9))
    grid = np.linspace(forces.min(), forces.max(), POINTS)
    logs, covariance = _regress(forces, np.maximum(heights / scale_n, LEAST), grid)
    rng = np.random.default_rng(1)
    variances, axes = np.linalg.eigh(covariance)
    spread = np.sqrt(np.maximum(variances, 0.0))
    draws = logs + (rng.standard_normal((DRAWS, POINTS)) * spread) @ axes.T
    best, light, deepest = _levels(grid, logs)
    found = [_levels(grid, draw) for draw in draws]
    height_n = scale_n * np.exp(logs)
    deviation_n = height_n * np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    top = int(logs.argmax())
    return DepthCurve(
        points,
        grid,
        height_n,
        deviation_n,
        Estimate(best, float(np.std([each[0] for each in found]))),
        Estimate(float(height_n[top]), float(deviation_n[top])),
        _estimate(light, [each[1] for each in found]),
        _estimate(deepest, [each[2] for each in found]),
    )


def _levels(grid: Floats, logs: Floats) -> tuple[float, float | None, float | None]:
    """Return the best force, and those of the levels before and after it."""
    top = int(logs.argmax())
    best = int((logs >= logs[top] + math.log(1 - FLAT)).argmax())
    low = logs < logs[top] + math.log(LEVEL_SHARE)
    before, after = np.flatnonzero(low[:top]), np.flatnonzero(low[top:])
    light = float(grid[before[-1] + 1]) if len(before) else None
    deepest = float(grid[top + after[0]]) if len(after) else None
    return float(grid[best]), light, deepest


def _estimate(value: float | None, draws: Sequence[float | None]) -> Estimate | None:
    known = [draw for draw in draws if draw is not None]
    return None if value is None else Estimate(value, float(np.std(known)) if known else math.nan)


def _regress(forces: Floats, heights: Floats, grid: Floats) -> tuple[Floats, Floats]:
    """Return mean and covariance of the logarithm on a grid, with the likeliest constants."""
    logs, weights = np.log(heights), 1 / (1 + (SMALL / heights) ** 2)
    parabola = np.polyfit(forces, logs, 2, w=np.sqrt(weights))
    logs = logs - np.polyval(parabola, forces)
    bend, reach_n, error = BENDS[0], REACHES_N[0], ERRORS[-1]
    robust = weights
    for _ in range(ROUNDS):
        bend, reach_n, error = max(
            product(BENDS, REACHES_N, ERRORS),
            key=lambda each: _log_likelihood(forces, logs, robust, *each),
        )
        gains = np.linalg.inv(_noisy(forces, robust, bend, reach_n, error))
        rest = logs - _kernel(forces, forces, bend, reach_n) @ (gains @ logs)
        robust = weights * (FREEDOM + 1) / (FREEDOM + weights * (rest / error) ** 2)
    across = _kernel(grid, forces, bend, reach_n)
    gains = np.linalg.inv(_noisy(forces, robust, bend, reach_n, error))
    mean: Floats = np.polyval(parabola, grid) + across @ (gains @ logs)
    covariance: Floats = _kernel(grid, grid, bend, reach_n) - across @ gains @ across.T
    return mean, covariance


def _kernel(a: Floats, b: Floats, bend: float, reach_n: float) -> Floats:
    """Return the covariance at two sets of forces, before anything is measured."""
    apart = (a[:, None] - b[None, :]) / reach_n
    covariance: Floats = bend**2 * np.exp(-0.5 * apart**2)
    return covariance


def _noisy(forces: Floats, weights: Floats, bend: float, reach_n: float, error: float) -> Floats:
    """Return the covariance of what is measured."""
    covariance: Floats = _kernel(forces, forces, bend, reach_n) + np.diag(error**2 / weights)
    return covariance


def _log_likelihood(
    forces: Floats, logs: Floats, weights: Floats, bend: float, reach_n: float, error: float
) -> float:
    """Return the log marginal likelihood (Rasmussen and Williams, equation 2.30)."""
    factor = np.linalg.cholesky(_noisy(forces, weights, bend, reach_n, error))
    white = np.linalg.solve(factor, logs)
    return -0.5 * float(white @ white) - float(np.log(factor.diagonal()).sum())
