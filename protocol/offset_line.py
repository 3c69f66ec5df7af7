"""Straight lines of clock offset over time, by weighted least squares, and how sure they are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# What is thought of the noise beforehand counts like so many points.
NOISE_POINTS = 4.0


@dataclass(frozen=True, slots=True)
class OffsetLines:
    """Lines offset(t) = offset_ns + skew (t - middle_ns), one an entry of the arrays.

    offset_error_ns: standard error in the middle; skew_error: of the slope.
    """

    middle_ns: Floats
    offset_ns: Floats
    skew: Floats
    offset_error_ns: Floats
    skew_error: Floats

    def at(self, t_ns: float) -> Floats:
        """The offsets at a time, ns."""
        offset_ns: Floats = self.offset_ns + self.skew * (t_ns - self.middle_ns)
        return offset_ns

    def error_at(self, t_ns: float) -> Floats:
        """Their standard errors, ns."""
        error_ns: Floats = np.hypot(self.offset_error_ns, self.skew_error * (t_ns - self.middle_ns))
        return error_ns


def fit_lines(
    t_ns: Floats, offset_ns: Floats, weight: Floats, noise_ns: Floats | float, usual_skew: float
) -> OffsetLines:
    """Lines through points of unequal weight; the best ones weigh 1.

    t_ns: (points,); offset_ns and weight: (points, lines). noise_ns: standard deviation that a
    point of weight 1 is thought to have, of all lines or of each. usual_skew: standard deviation
    of clocks' skews. Both are known beforehand, so that few points give neither a wild slope nor
    a proud error.
    """
    total = weight.sum(axis=0)
    middle_ns = (weight * t_ns[:, None]).sum(axis=0) / total
    mean_ns = (weight * offset_ns).sum(axis=0) / total
    x_ns, y_ns = t_ns[:, None] - middle_ns, offset_ns - mean_ns
    weighted_ns = weight * x_ns
    spread, slope = (weighted_ns * x_ns).sum(axis=0), (weighted_ns * y_ns).sum(axis=0)
    # The free line's residuals tell the noise, and the noise how much the usual skew counts.
    residual_ns = y_ns - x_ns * (slope / np.maximum(spread, 1.0))
    squares = (weight * residual_ns**2).sum(axis=0) + NOISE_POINTS * np.square(noise_ns)
    variance = squares / (np.maximum(total - 2, 0) + NOISE_POINTS)
    known = spread + variance / usual_skew**2
    return OffsetLines(
        middle_ns, mean_ns, slope / known, np.sqrt(variance / total), np.sqrt(variance / known)
    )
