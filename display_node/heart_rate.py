"""Heart rate from a stretch of pulse."""

import numpy as np
from numpy.typing import NDArray

SHORTEST_BEAT_S = 0.3


def heart_rate_per_min(t_s: NDArray[np.float64], force_n: NDArray[np.float64]) -> float | None:
    """Beats a minute by the median interval of the tall peaks; None with fewer than two beats.

    t_s: times in s, evenly spaced; force_n: the pulse, same shape.
    """
    from scipy.signal import find_peaks

    if len(t_s) < 3 or np.ptp(force_n) == 0:
        return None
    spacing_s = (t_s[-1] - t_s[0]) / (len(t_s) - 1)
    low, high = np.percentile(force_n, [5, 99])
    peaks, _ = find_peaks(
        force_n,
        prominence=0.5 * (high - low),
        distance=max(1, round(SHORTEST_BEAT_S / spacing_s)),
    )
    if len(peaks) < 2:
        return None
    return float(60 / np.median(np.diff(t_s[peaks])))
