"""A microcontroller's micros(), which begins again at 0 after 2^32, as a time that only grows."""

_TURN = 1 << 32
# No device that runs is silent for longer; its time has stepped, or it began anew.
LONGEST_PAUSE_NS = 10_000_000_000


class DeviceTime:
    """Follows a count of µs, of which only the low 32 bits need be right.

    millis() in µs fits too: where it begins again, 1000 whole turns of 2^32 have passed.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._last_ns = 0

    @property
    def begun(self) -> bool:
        """Whether there is a last time."""
        return self._last_us is not None

    def since_last_ns(self, now_us: int) -> int | None:
        """How long after the last time this one is; None when the two do not belong together."""
        if self._last_us is None:
            return None
        passed_ns = (now_us - self._last_us) % _TURN * 1_000
        return passed_ns if 0 < passed_ns <= LONGEST_PAUSE_NS else None

    def take(self, now_us: int) -> int:
        """The time in ns, as the last from now on; it goes on from the last if the two belong
        together, and else begins with the count itself."""
        passed_ns = self.since_last_ns(now_us)
        self._last_ns = now_us % _TURN * 1_000 if passed_ns is None else self._last_ns + passed_ns
        self._last_us = now_us
        return self._last_ns
