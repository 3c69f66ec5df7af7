"""Quantiles of a stream of numbers in fixed memory, cheap enough for the real-time loop."""


class Histogram:
    """Counts of values in equal bins from 0; what lies above the last bin is in the last bin.

    A quantile is exact to one bin; maximum and mean are exact.
    """

    __slots__ = ("_bin_width", "_counts", "_last", "_total", "count", "maximum")

    def __init__(self, bin_width: float, bins: int) -> None:
        self._bin_width = bin_width
        self._counts = [0] * bins
        self._last = bins - 1
        self._total = 0.0
        self.count = 0
        self.maximum: float | None = None

    def add(self, value: float) -> None:
        """Count a value; below 0 it falls into the first bin."""
        position = int(value / self._bin_width)
        self._counts[0 if position < 0 else min(position, self._last)] += 1
        self._total += value
        self.count += 1
        if self.maximum is None or value > self.maximum:
            self.maximum = value

    @property
    def mean(self) -> float | None:
        """Mean of all values; None without any."""
        return self._total / self.count if self.count else None

    def quantile(self, share: float) -> float | None:
        """The middle of the bin below which `share` (0 to 1) of the values lie, or the maximum
        where the last bin's values have no bin of their own; None without any."""
        if not self.count or self.maximum is None:
            return None
        wanted = share * self.count
        seen = 0
        for position, count in enumerate(self._counts):
            seen += count
            if seen >= wanted and count:
                if position == self._last:
                    return self.maximum
                return min((position + 0.5) * self._bin_width, self.maximum)
        return self.maximum
