"""Quantiles of a stream of numbers in fixed memory, cheap enough for the real-time loop."""

import math
from collections.abc import Collection
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

# Values that are counted at once.
BLOCK: Final = 512


class Histogram:
    """Counts of values in equal bins from 0 up to `end`, and of those beyond.

    A quantile within the range is exact to one bin. Of a quantile beyond it, only the lower bound
    `end` is known. Maximum (None without values) and mean are exact. NaN are not counted.
    """

    __slots__ = ("_bin_width", "_count", "_counts", "_maximum", "_total", "_waiting", "end")

    def __init__(self, bin_width: float, bins: int) -> None:
        self._bin_width = bin_width
        # The last bin counts the values beyond the range.
        self._counts = np.zeros(bins + 1, np.int64)
        self._count, self._total, self._maximum = 0, 0.0, -math.inf
        # Values that were added since the last count: arrays count many of them at once.
        self._waiting: list[float] = []
        self.end = bin_width * bins

    def add(self, value: float) -> None:
        """Count a value; below 0 it falls into the first bin."""
        self._waiting.append(value)
        if len(self._waiting) >= BLOCK:
            self._count_waiting()

    def add_all(self, values: NDArray[np.float64]) -> None:
        """Count values, shape (n,)."""
        self._waiting += values.tolist()
        if len(self._waiting) >= BLOCK:
            self._count_waiting()

    @property
    def count(self) -> int:
        """Number of values."""
        if self._waiting:
            self._count_waiting()
        return self._count

    @property
    def maximum(self) -> float | None:
        """The largest value; None without any."""
        return self._maximum if self.count else None

    @property
    def mean(self) -> float | None:
        """Mean of all values; None without any."""
        count = self.count
        return self._total / count if count else None

    def quantile(self, share: float) -> float | None:
        """Return the quantile for a share of 0 to 1: the middle of its bin.

        Returns `end`, a lower bound, where the quantile `is_beyond` the range; None without values.
        """
        count = self.count
        if not count:
            return None
        if self.is_beyond(share):
            return self.end
        # The maximum is within the range or beyond it, and nothing is counted after its bin.
        used = int(min(self._maximum, self.end) / self._bin_width) + 1
        seen = self._counts[: max(used, 1)].cumsum()
        position = int(np.searchsorted(seen, max(share * count, 1)))
        return min((position + 0.5) * self._bin_width, self._maximum)

    def quantiles(self, **shares: float) -> dict[str, Any]:
        """Return quantiles by name, and as "beyond" the names of those beyond the range.

        `quantiles(p50=0.5, p99=0.99)` has the fields of a group of the summary.
        """
        beyond = [name for name, share in shares.items() if self.is_beyond(share)]
        return {name: self.quantile(share) for name, share in shares.items()} | {"beyond": beyond}

    def is_beyond(self, share: float) -> bool:
        """Return whether a quantile is beyond the range."""
        count = self.count
        within = count - int(self._counts[-1])
        return count > 0 and (not within or within < share * count)

    def _count_waiting(self) -> None:
        values = np.array(self._waiting)
        self._waiting = []
        values = values[~np.isnan(values)]
        if not len(values):
            return
        last = len(self._counts) - 2
        # Rounding may give the number of bins itself, one too many.
        positions = np.minimum(np.maximum(values / self._bin_width, 0), last).astype(np.int64)
        positions[values >= self.end] = last + 1
        np.add.at(self._counts, positions, 1)
        self._count += len(values)
        self._maximum = max(self._maximum, float(values.max()))
        # `cumsum` adds one value after the other, so the mean does not depend on when it is read.
        values[0] += self._total
        self._total = float(values.cumsum()[-1])


def bound(name: str, beyond: Collection[str]) -> str:
    """Return the prefix of a quantile's figure: "> " if it is a lower bound, else empty."""
    return "> " if name in beyond else ""
