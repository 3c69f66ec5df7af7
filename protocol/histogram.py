"""Quantiles of a stream of numbers in fixed memory, cheap enough for the real-time loop."""

import math
from collections.abc import Collection
from typing import Any


class Histogram:
    """Counts of values in equal bins from 0 up to `end`, and of those beyond.

    A quantile within the range is exact to one bin. Of a quantile beyond it, only the lower bound
    `end` is known. Maximum (None without values) and mean are exact. NaN are not counted.
    """

    __slots__ = ("_bin_width", "_counts", "_last", "_total", "count", "end", "maximum")

    def __init__(self, bin_width: float, bins: int) -> None:
        self._bin_width = bin_width
        # The last bin counts the values beyond the range.
        self._counts = [0] * (bins + 1)
        self._last = bins - 1
        self._total = 0.0
        self.end = bin_width * bins
        self.count = 0
        self.maximum: float | None = None

    def add(self, value: float) -> None:
        """Count a value; below 0 it falls into the first bin."""
        if value >= self.end:
            position = -1
        elif value > 0.0:
            position = int(value / self._bin_width)
            # Rounding may give the number of bins itself, one too many.
            if position > self._last:
                position = self._last
        elif math.isnan(value):
            return
        else:
            position = 0
        self._counts[position] += 1
        self._total += value
        self.count += 1
        if self.maximum is None or value > self.maximum:
            self.maximum = value

    @property
    def mean(self) -> float | None:
        """Mean of all values; None without any."""
        return self._total / self.count if self.count else None

    def quantile(self, share: float) -> float | None:
        """Return the quantile for a share of 0 to 1: the middle of its bin.

        Returns `end`, a lower bound, where the quantile `is_beyond` the range; None without values.
        """
        if self.maximum is None:
            return None
        if self.is_beyond(share):
            return self.end
        wanted, seen = share * self.count, 0
        for position, count in enumerate(self._counts):
            seen += count
            if seen >= wanted and count:
                return min((position + 0.5) * self._bin_width, self.maximum)
        return self.end

    def quantiles(self, **shares: float) -> dict[str, Any]:
        """Return quantiles by name, and as "beyond" the names of those beyond the range.

        `quantiles(p50=0.5, p99=0.99)` has the fields of a group of the summary.
        """
        beyond = [name for name, share in shares.items() if self.is_beyond(share)]
        return {name: self.quantile(share) for name, share in shares.items()} | {"beyond": beyond}

    def is_beyond(self, share: float) -> bool:
        """Return whether a quantile is beyond the range."""
        within = self.count - self._counts[-1]
        return self.count > 0 and (not within or within < share * self.count)


def bound(name: str, beyond: Collection[str]) -> str:
    """Return the prefix of a quantile's figure: "> " if it is a lower bound, else empty."""
    return "> " if name in beyond else ""
