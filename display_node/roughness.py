"""Roughness: how much of the felt force is above 25 Hz, beside what was sensed there. Pure.

The pulse itself ends below; what is above is noise, and the jumps that prediction adds.
"""

import math

import numpy as np
from numpy.typing import NDArray

from protocol.summary import Roughness

ABOVE_HZ = 25.0
# Half the filter's length; its edge is ±14 Hz wide, and a pulse's slow part 70 dB down.
REACH_S = 0.1
Floats = NDArray[np.float64]


class RoughnessMeter:
    """Sums the energy above 25 Hz of felt and sensed force over the same ticks."""

    def __init__(self) -> None:
        self._kernel = np.empty(0)
        self._period_ns = 0
        self._last_ns = 0
        self._felt_n, self._sensed_n = np.empty(0), np.empty(0)
        self._felt = self._sensed = 0.0
        self._count = 0

    def add(self, now_ns: NDArray[np.int64], felt_n: Floats, sensed_n: Floats) -> None:
        """Take consecutive ticks, the next ones at each call; NaN where nothing was sensed, or
        the force felt is unknown.

        Around a NaN, and where ticks are missing, nothing is counted.
        """
        if len(now_ns) < 2:
            return
        period_ns = int(np.median(np.diff(now_ns)))
        # Ticks are read on a clock that is corrected now and then.
        if abs(period_ns - self._period_ns) > 0.1 * self._period_ns:
            self._period_ns, self._kernel = period_ns, high_pass(period_ns * 1e-9)
            self._felt_n, self._sensed_n = np.empty(0), np.empty(0)
        missing = np.diff(now_ns, prepend=self._last_ns) > 1.5 * period_ns
        missing |= ~np.isfinite(felt_n)
        felt_n = np.where(np.isfinite(felt_n), felt_n, 0.0)
        self._last_ns = int(now_ns[-1])
        felt_n = np.concatenate([self._felt_n, felt_n])
        sensed_n = np.concatenate([self._sensed_n, np.where(missing, np.nan, sensed_n)])
        keep = max(len(self._kernel) - 1, 0)
        kept = slice(max(0, len(felt_n) - keep), None)
        self._felt_n, self._sensed_n = felt_n[kept], sensed_n[kept]
        if not keep or len(felt_n) <= keep:
            return
        sensed = np.convolve(sensed_n, self._kernel, "valid")
        counted = ~np.isnan(sensed)
        felt, sensed = np.convolve(felt_n, self._kernel, "valid")[counted], sensed[counted]
        self._felt += float(felt @ felt)
        self._sensed += float(sensed @ sensed)
        self._count += len(felt)

    @property
    def roughness(self) -> Roughness:
        """So far; nothing before 0.2 s in one piece, or with ticks too slow for 25 Hz."""
        if not self._count:
            return Roughness()
        ratio = self._felt / self._sensed if self._sensed else None
        felt_n, sensed_n = (math.sqrt(sum_ / self._count) for sum_ in (self._felt, self._sensed))
        return Roughness(felt_n, sensed_n, ratio)


def high_pass(period_s: float) -> Floats:
    """A symmetric filter that lets pass what is above 25 Hz, at a sample each period_s: all
    minus a windowed sinc (Blackman). Empty where so slow a rate holds nothing above 25 Hz."""
    if 2 * ABOVE_HZ * period_s >= 1:
        return np.empty(0)
    reach = round(REACH_S / period_s)
    t_s = np.arange(-reach, reach + 1) * period_s
    low_pass = np.sinc(2 * ABOVE_HZ * t_s) * np.blackman(2 * reach + 1)
    kernel = -low_pass / low_pass.sum()
    kernel[reach] += 1
    return np.asarray(kernel)
