"""Hold: the newest value."""


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
        """The newest value."""
        return self._value

    def error_n(self, horizon_ns: int) -> float | None:
        """Nothing is known of it."""
        return None
