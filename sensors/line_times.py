"""The times that a device prints beside its values: they show lost lines, and wrong digits.

A time close after the last one is believed at once. One that is not is believed when the next
goes on from it: lines were lost in between, or the device began anew.
"""

from typing import NamedTuple

from protocol.errors import WireError
from sensors.device_time import DeviceTime

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
        """A line's time; `spoilt` lines just before it could not be read.

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
