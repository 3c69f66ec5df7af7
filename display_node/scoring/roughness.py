"""Roughness: energy of the felt force above 25 Hz, compared with that of the sensed force. Pure.

The pulse itself ends below 25 Hz; above are noise, and jumps caused by prediction.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.summary.fields import Roughness

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
ABOVE_HZ: Final = 25.0
# Half the filter's length. Its edge is ±14 Hz wide, and it attenuates slow parts by 70 dB.
REACH_S: Final = 0.1


class RoughnessMeter:
    """Meter of the energy above 25 Hz of felt and sensed force over the same ticks."""

    def __init__(self) -> None:
        self._kernel = np.empty(0)
        self._period_ns = 0
        self._last_ns = 0
        self._felt_n = self._sensed_n = np.empty(0)
        self._felt = self._sensed = 0.0
        self._count = 0

    def add(self, now_ns: Times, felt_n: Floats, sensed_n: Floats) -> None:
        """Add consecutive ticks, shape (n,); each call continues the last one.

        Ticks close to an unknown force (NaN) or to missing ticks are not counted.
        """
        if len(now_ns) < 2:
            return
        # Quicker than a median of numpy's.
        period_ns = int(np.sort(now_ns[1:] - now_ns[:-1])[(len(now_ns) - 1) // 2])
        # The tick's period on the sensing clock varies slightly, as that clock is corrected.
        if abs(period_ns - self._period_ns) > 0.1 * self._period_ns:
            self._period_ns, self._kernel = period_ns, high_pass(period_ns * 1e-9)
            self._felt_n = self._sensed_n = np.empty(0)
        missing = np.diff(now_ns, prepend=self._last_ns) > 1.5 * period_ns
        unknown = ~np.isfinite(felt_n)
        missing |= unknown
        felt_n = np.where(unknown, 0.0, felt_n)
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
        """Roughness so far; None before an uninterrupted 0.2 s, or if ticks are too slow."""
        ratio = self._felt / self._sensed if self._sensed else None
        return Roughness(_root(self._felt, self._count), _root(self._sensed, self._count), ratio)


def high_pass(period_s: float) -> Floats:
    """Return a symmetric high-pass above 25 Hz: an all-pass minus a windowed sinc (Blackman).

    It is empty if the sampling period is too long for 25 Hz.
    """
    if 2 * ABOVE_HZ * period_s >= 1:
        return np.empty(0)
    reach = round(REACH_S / period_s)
    t_s = np.arange(-reach, reach + 1) * period_s
    low_pass = np.sinc(2 * ABOVE_HZ * t_s) * np.blackman(2 * reach + 1)
    kernel = -low_pass / low_pass.sum()
    kernel[reach] += 1
    return np.asarray(kernel)


def _root(total: float, count: int) -> float | None:
    return math.sqrt(total / count) if count else None
