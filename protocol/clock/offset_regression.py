"""Straight lines of clock offset over time, by weighted least squares, and how sure they are."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# What is thought of the noise beforehand counts like so many points.
NOISE_POINTS = 4.0


class OffsetRegression(NamedTuple):
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
) -> OffsetRegression:
    """Lines through points of unequal weight; the best ones weigh 1.

    t_ns: (points,); offset_ns and weight: (points, lines). noise_ns: standard deviation that a
    point of weight 1 is thought to have, of all lines or of each. usual_skew: standard deviation
    of clocks' skews. Both are known beforehand, so that few points give neither a wild slope nor
    a proud error.
    """
    # Counted from points of theirs, so that the sums of squares lose no digits.
    about_ns, zero_ns = t_ns[len(t_ns) // 2], offset_ns[-1]
    x_ns, y_ns = t_ns - about_ns, offset_ns - zero_ns
    powers = np.array((np.ones(len(t_ns)), x_ns, x_ns * x_ns))
    weighted_ns = weight * y_ns
    total, x_sum, xx_sum = powers @ weight
    y_sum, xy_sum = powers[:2] @ weighted_ns
    x_mean, y_mean = x_sum / total, y_sum / total
    spread, slope = xx_sum - x_mean * x_sum, xy_sum - x_mean * y_sum
    # The free line's residuals tell the noise, and the noise how much the usual skew counts.
    squares = np.einsum("ij,ij->j", weighted_ns, y_ns) - y_mean * y_sum
    squares -= slope * slope / np.maximum(spread, 1.0)
    # Where a line fits exactly, rounding may leave less than nothing.
    variance = np.maximum(squares, 0) + NOISE_POINTS * np.square(noise_ns)
    variance /= np.maximum(total - 2, 0) + NOISE_POINTS
    known = spread + variance / usual_skew**2
    middle_ns, mean_ns = about_ns + x_mean, zero_ns + y_mean
    return OffsetRegression(
        middle_ns, mean_ns, slope / known, np.sqrt(variance / total), np.sqrt(variance / known)
    )
