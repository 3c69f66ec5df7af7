"""A microcontroller's micros(), which begins again at 0 after 2^32, as a time that only grows.

A device's count of its samples: what jumped it is lost, if the time says so too.

The times that a device prints beside its values: they show lost lines, and wrong digits.

A time close after the last one is believed at once. One that is not is believed when the next
goes on from it: lines were lost in between, or the device began anew.
"""

from typing import NamedTuple

from protocol.errors import WireError

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
        """Return the number of samples lost between the last one and `count` new ones.

        first: number of the first new sample.

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
        """Return the time in ns, and keep it as the last one.

        It continues from the last time if the two belong together, and else begins with the count
        itself.
        """
        passed_ns = self.since_last_ns(now_us)
        self._last_ns = now_us % _TURN * 1_000 if passed_ns is None else self._last_ns + passed_ns
        self._last_us = now_us
        return self._last_ns


# A gap of more samples than this must be confirmed by the line that follows.
PLAUSIBLE_MISSING = 3
LEARNING = 0.01


class LineTime(NamedTuple):
    """A line's time in ns, how many lines are missing before it, and whether its clock is anew."""

    device_ns: int
    missing: int
    anew: bool


class LineTimes:
    """Follows the times of lines that come one a period, or nearly."""

    def __init__(self, period_ns: int, quantum_ns: int) -> None:
        """period_ns: the nominal one; the true one is learnt. quantum_ns: the times' grain."""
        self._period_ns = float(period_ns)
        self._quantum_ns = quantum_ns
        self._time = DeviceTime()
        self._suspect: DeviceTime | None = None

    def take(self, now_us: int, spoilt: int) -> LineTime:
        """Return a line's time; `spoilt` lines just before it could not be read.

        Raises WireError("device_time") for one that is not, or not yet, believed.
        """
        passed_ns = self._time.since_last_ns(now_us)
        if not self._time.begun:
            return LineTime(self._time.take(now_us), 0, anew=True)
        if not self._follows(passed_ns, spoilt):
            suspect, self._suspect = self._suspect, DeviceTime()
            self._suspect.take(now_us)
            if suspect is None or not self._follows(suspect.since_last_ns(now_us), 0):
                raise WireError("device_time", "a time that does not follow the last ones")
        self._suspect = None
        if passed_ns is None:
            return LineTime(self._time.take(now_us), 0, anew=True)
        missing = self._missing(passed_ns, spoilt)
        if missing <= PLAUSIBLE_MISSING + spoilt:
            self._period_ns += LEARNING * (passed_ns / (1 + missing) - self._period_ns)
        return LineTime(self._time.take(now_us), missing, anew=False)

    def _follows(self, passed_ns: int | None, spoilt: int) -> bool:
        """Whether no more lines are missing than may be without a word."""
        most_ns = (1 + PLAUSIBLE_MISSING + spoilt) * self._period_ns + self._quantum_ns
        return passed_ns is not None and passed_ns <= most_ns

    def _missing(self, passed_ns: int, spoilt: int) -> int:
        """Lines missing in the time passed: those that were spoilt, if that can be."""
        missing = passed_ns / self._period_ns - 1
        if abs(missing - spoilt) <= 0.5 + self._quantum_ns / self._period_ns:
            return spoilt
        return max(0, round(missing))
