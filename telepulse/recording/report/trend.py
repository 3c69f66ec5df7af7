"""Course of a value over a time of any length, in fixed memory. Pure."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BINS = 1_000
NARROWEST_S = 0.1
Floats = NDArray[np.float64]


class TrendPoints(NamedTuple):
    """Bins that hold values: their middles in s, and least, greatest, mean and sum of each."""

    t_s: Floats
    low: Floats
    high: Floats
    mean: Floats
    total: Floats


class Trend:
    """Statistics of values in equal bins of time, which double their width as time goes on."""

    def __init__(self, width_s: float = NARROWEST_S) -> None:
        """Begin with bins of a width."""
        self.width_s = width_s
        self._low, self._high = np.full(BINS, np.inf), np.full(BINS, -np.inf)
        self._total, self._count = np.zeros(BINS), np.zeros(BINS)

    def add(self, t_s: Floats, values: Floats) -> None:
        """Add values at times from the begin; what is NaN or infinite is left out."""
        known = np.isfinite(values)
        t_s, values = np.maximum(t_s[known], 0), values[known]
        if not len(values):
            return
        while t_s.max() >= self.width_s * BINS:
            self._widen()
        at = (t_s / self.width_s).astype(np.int64)
        np.minimum.at(self._low, at, values)
        np.maximum.at(self._high, at, values)
        np.add.at(self._total, at, values)
        np.add.at(self._count, at, 1)

    def points(self) -> TrendPoints:
        """Return the bins that hold values."""
        held = np.flatnonzero(self._count)
        mean: Floats = self._total[held] / self._count[held]
        t_s: Floats = np.asarray((held + 0.5) * self.width_s, float)
        return TrendPoints(t_s, self._low[held], self._high[held], mean, self._total[held])

    def _widen(self) -> None:
        self.width_s *= 2
        rest = BINS // 2
        self._low = np.append(self._low.reshape(-1, 2).min(axis=1), np.full(rest, np.inf))
        self._high = np.append(self._high.reshape(-1, 2).max(axis=1), np.full(rest, -np.inf))
        self._total = np.append(self._total.reshape(-1, 2).sum(axis=1), np.zeros(rest))
        self._count = np.append(self._count.reshape(-1, 2).sum(axis=1), np.zeros(rest))
