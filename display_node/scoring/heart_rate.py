"""Heart rate from a stretch of pulse."""

import numpy as np
from numpy.typing import NDArray

SHORTEST_BEAT_S = 0.3
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
        None where that stretch has fewer than two beats, or the newest value is NaN.
    """
    from scipy.signal import find_peaks

    apart_s = np.diff(t_s)
    broken = ~((apart_s > 0) & (apart_s <= LONGEST_HOLE_S)) | ~np.isfinite(force_n[:-1])
    begin = int(np.flatnonzero(broken)[-1]) + 1 if broken.any() else 0
    t_s, force_n = t_s[begin:], force_n[begin:]
    if len(t_s) < 3 or not np.isfinite(force_n[-1]) or np.ptp(force_n) == 0:
        return None
    spacing_s = (t_s[-1] - t_s[0]) / (len(t_s) - 1)
    low, high = np.percentile(force_n, [5, 99])
    peaks, _ = find_peaks(
        force_n, prominence=0.5 * (high - low), distance=max(1, round(SHORTEST_BEAT_S / spacing_s))
    )
    if len(peaks) < 2:
        return None
    return float(60 / np.median(np.diff(t_s[peaks])))
