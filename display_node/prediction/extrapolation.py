"""Predictors that learn nothing: hold the newest value, or carry it on by its slope."""

from bisect import insort

WINDOW_NS = 10_000_000
REACH_NS = 20_000_000
KEEP = 32


class Linear:
    """Predicts a straight line, which soon ends."""

    def __init__(self) -> None:
        self._samples: list[tuple[int, float]] = []

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take samples (`Predictor`)."""
        samples = self._samples
        if samples and times_ns[0] < samples[-1][0]:
            for sample in zip(times_ns, values, strict=True):
                insort(samples, sample)
        else:
            samples.extend(zip(times_ns, values, strict=True))
        del samples[:-KEEP]

    def work(self) -> None:
        """There is none."""

    def predict(self, instant_ns: int) -> float:
        """Return the newest value carried on by the slope of the last 10 ms, for at most 20 ms."""
        samples = self._samples
        if not samples:
            return 0.0
        newest_ns, newest = samples[-1]
        start = len(samples) - 1
        while start > 0 and newest_ns - samples[start - 1][0] <= WINDOW_NS:
            start -= 1
        first_ns, first = samples[start]
        if newest_ns == first_ns:
            return newest
        slope = (newest - first) / (newest_ns - first_ns)
        return newest + slope * min(instant_ns - newest_ns, REACH_NS)

    def error_n(self, horizon_ns: int) -> float | None:
        """Nothing is known of it."""
        return None


class Hold:
    """Predicts that nothing changes."""

    def __init__(self) -> None:
        self._newest_ns = -(1 << 64)
        self._value = 0.0

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take samples (`Predictor`)."""
        if times_ns[-1] > self._newest_ns:
            self._newest_ns, self._value = times_ns[-1], values[-1]

    def work(self) -> None:
        """There is none."""

    def predict(self, instant_ns: int) -> float:
        """Return the newest value."""
        return self._value

    def error_n(self, horizon_ns: int) -> float | None:
        """Nothing is known of it."""
        return None
