"""Straight lines of clock offset over time by weighted least squares, with standard errors."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Weight of the expected noise, in points.
NOISE_POINTS = 4.0


class OffsetRegression(NamedTuple):
    """Lines offset(t) = offset_ns + skew (t - middle_ns); arrays of shape (lines,).

    Attributes
    ----------
    middle_ns : ndarray
        Weighted mean of the points' times.
    offset_ns : ndarray
        Offset there.
    skew : ndarray
        Slope.
    offset_error_ns, skew_error : ndarray
        Their standard errors.
    """

    middle_ns: Floats
    offset_ns: Floats
    skew: Floats
    offset_error_ns: Floats
    skew_error: Floats

    def at(self, t_ns: float) -> Floats:
        """Return the offsets at a time, in ns."""
        offset_ns: Floats = self.offset_ns + self.skew * (t_ns - self.middle_ns)
        return offset_ns

    def error_at(self, t_ns: float) -> Floats:
        """Return the standard errors of the offsets at a time, in ns."""
        error_ns: Floats = np.hypot(self.offset_error_ns, self.skew_error * (t_ns - self.middle_ns))
        return error_ns


def fit_lines(
    t_ns: Floats, offset_ns: Floats, weight: Floats, noise_ns: Floats | float, usual_skew: float
) -> OffsetRegression:
    """Fit lines through weighted points, with prior knowledge of noise and skew.

    The priors bound the slope and the standard errors where there are few points.

    Parameters
    ----------
    t_ns : ndarray, shape (points,)
        Times.
    offset_ns : ndarray, shape (points, lines)
        Offsets.
    weight : ndarray, shape (points, lines)
        Weights; the best points have 1.
    noise_ns : ndarray, shape (lines,), or float
        Expected standard deviation of a point of weight 1.
    usual_skew : float
        Expected standard deviation of clocks' skews.
    """
    # Relative to one of the points, so that the sums of squares lose no digits.
    about_ns, zero_ns = t_ns[len(t_ns) // 2], offset_ns[-1]
    x_ns, y_ns = t_ns - about_ns, offset_ns - zero_ns
    powers = np.array((np.ones(len(t_ns)), x_ns, x_ns * x_ns))
    weighted_ns = weight * y_ns
    total, x_sum, xx_sum = powers @ weight
    y_sum, xy_sum = powers[:2] @ weighted_ns
    x_mean, y_mean = x_sum / total, y_sum / total
    spread, slope = xx_sum - x_mean * x_sum, xy_sum - x_mean * y_sum
    # The unconstrained line's residuals give the noise, and the noise the weight of the usual skew.
    squares = np.einsum("ij,ij->j", weighted_ns, y_ns) - y_mean * y_sum
    squares -= slope * slope / np.maximum(spread, 1.0)
    # Where a line fits exactly, rounding may leave less than 0.
    variance = np.maximum(squares, 0) + NOISE_POINTS * np.square(noise_ns)
    variance /= np.maximum(total - 2, 0) + NOISE_POINTS
    information = spread + variance / usual_skew**2
    middle_ns, mean_ns = about_ns + x_mean, zero_ns + y_mean
    return OffsetRegression(
        middle_ns,
        mean_ns,
        slope / information,
        np.sqrt(variance / total),
        np.sqrt(variance / information),
    )
