"""Heart rate from a stretch of pulse."""

import numpy as np
from numpy.typing import NDArray

# A rate above this one is not counted.
FASTEST_PER_MIN = 306
# A peak is a second wave where it is lower than this share of the peaks around it and follows the
# first within this share of their interval.
SECOND_HEIGHT, SECOND_WITHIN = 0.8, 0.67
# Longest gap in time within one stretch; a longer one may hide part of a beat.
LONGEST_HOLE_S = 0.25


def heart_rate_per_min(t_s: NDArray[np.float64], force_n: NDArray[np.float64]) -> float | None:
    """Return the beats per minute at the end of a pulse, from the median interval of its peaks.

    Only the newest uninterrupted stretch is used: without NaN, without a gap longer than
    `LONGEST_HOLE_S`, and with rising times.

    Parameters
    ----------
    t_s : ndarray, shape (n,)
        Times in s, evenly spaced except for gaps.
    force_n : ndarray, shape (n,)
        Force of the pulse in N; NaN where it is not felt or unknown.

    Returns
    -------
    float or None
        None where that stretch has fewer than two beats, the newest value is NaN, or the rate is
        above 300 /min.
    """
    from scipy.signal import find_peaks

    apart_s = np.diff(t_s)
    broken = ~((apart_s > 0) & (apart_s <= LONGEST_HOLE_S)) | ~np.isfinite(force_n[:-1])
    begin = int(np.flatnonzero(broken)[-1]) + 1 if broken.any() else 0
    t_s, force_n = t_s[begin:], force_n[begin:]
    if len(t_s) < 3 or not np.isfinite(force_n[-1]) or np.ptp(force_n) == 0:
        return None
    low, high = np.percentile(force_n, [5, 99])
    peaks, _ = find_peaks(force_n, prominence=0.5 * (high - low))
    peaks = _without_second_waves(t_s[peaks], force_n[peaks] - low)
    if len(peaks) < 2:
        return None
    rate_per_min = float(60 / np.median(np.diff(peaks)))
    return rate_per_min if rate_per_min <= FASTEST_PER_MIN else None


def _without_second_waves(
    t_s: NDArray[np.float64], height_n: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the times of the peaks that are not a second wave of the peak before."""
    if len(t_s) < 3:
        return t_s
    # Of the first and the last peak, only one neighbour is known.
    before_n = np.append(height_n[1], height_n[:-1])
    after_n = np.append(height_n[1:], height_n[-2])
    second = height_n < SECOND_HEIGHT * np.minimum(before_n, after_n)
    second[1:-1] &= t_s[1:-1] - t_s[:-2] < SECOND_WITHIN * (t_s[2:] - t_s[:-2])
    return np.asarray(t_s[~second])
