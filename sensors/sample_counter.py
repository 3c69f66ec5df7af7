"""A device's count of its samples: what jumped it is lost, if the time says so too."""

# A jump is believed when the time that passed fits, within this and half of it.
TOLERANCE_NS = 50_000_000


class SampleCounter:
    """Follows a count that begins again at 0 after `modulus`. Pure."""

    def __init__(self, modulus: int, period_ns: int) -> None:
        """period_ns: the samples' own, nominally."""
        self._modulus = modulus
        self._period_ns = period_ns
        self._next = 0

    def missing(self, first: int, count: int, passed_ns: int | None) -> int | None:
        """Samples between the last one and `count` new ones, of which `first` is the first.

        passed_ns: from the last one before to the last of these; None when nothing came before.
        None when the count says what the time does not.
        """
        jump = (first - self._next) % self._modulus
        self._next = first + count
        if passed_ns is None or not jump:
            return 0
        counted_ns = (jump + count) * self._period_ns
        fits = abs(passed_ns - counted_ns) <= TOLERANCE_NS + counted_ns // 2
        return jump if fits else None
