"""Lines of text as an Arduino sketch prints them: values, or the device's time and values.

Numbers are separated by blanks, commas or semicolons; a name before a colon, as for a plotter, is
skipped. Lines have no checksum: a wrong digit is detected in a time, but not in a value.
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import Literal

from protocol.errors import WireError
from pulse_sensors.sample_plausibility import is_usable
from pulse_sensors.samples import DecodedBlock, DeviceTime, join_samples

TimeUnit = Literal["us", "ms", "s"]

MAX_LINE_BYTES = 256
# Each unit's length in µs, and the resolution of times in it, in ns. The micros() of slow boards
# counts in 10 µs, times in ms are whole, times in s have three decimals. millis() counts in 1.024
# ms on many boards, and steps by 2 at times.
_UNITS: dict[TimeUnit, tuple[float, int]] = {
    "us": (1.0, 10_000),
    "ms": (1e3, 1_000_000),
    "s": (1e6, 1_000_000),
}
_BETWEEN = re.compile(rb"[\s,;]+")
# A gap of more samples than this must be confirmed by the line that follows.
PLAUSIBLE_MISSING = 3
LEARNING = 0.01


class LineTimes:
    """Check of the times of lines sent once a period, for lost lines and wrong digits.

    A time shortly after the last one is accepted. Any other time is rejected; if the next line's
    time follows it, that line is accepted: lines were lost, or the device has restarted. As many
    lines may have the same time as fall into its resolution. The true period is estimated.
    """

    def __init__(self, period_ns: int, unit: TimeUnit) -> None:
        self._period_ns = float(period_ns)
        self._unit_us, self._quantum_ns = _UNITS[unit]
        self._time = DeviceTime()
        self._suspect: DeviceTime | None = None
        # Lines with the last time, also lost ones.
        self._lines = 1

    def take(self, time: float, unreadable: int) -> tuple[int, int, bool]:
        """Return a line's `device_ns`, `missing` and `restarted`, as in `DecodedBlock`.

        unreadable: count of rejected lines directly before it. Raises WireError for a time that is
        not accepted yet.
        """
        now_us = round(time * self._unit_us)
        lines = self._lines + unreadable
        # Lines come somewhat early or late: half of the resolution is allowed for that.
        if now_us == self._time.last_us and lines * self._period_ns < 1.5 * self._quantum_ns:
            self._suspect, self._lines = None, lines + 1
            return self._time.last_ns, unreadable, False
        passed_ns = self._time.since_last_ns(now_us)
        if self._time.last_us is not None and not self._follows(passed_ns, lines):
            suspect, self._suspect = self._suspect, DeviceTime()
            self._suspect.take(now_us)
            if suspect is None or not self._follows(suspect.since_last_ns(now_us), 1):
                raise WireError("device_time", "a time that does not follow the last ones")
        self._suspect, self._lines = None, 1
        device_ns = self._time.take(now_us)
        if passed_ns is None:
            return device_ns, 0, True
        lost = passed_ns / self._period_ns - lines
        fits = abs(lost) <= 0.5 + self._quantum_ns / self._period_ns
        missing = unreadable if fits else max(0, unreadable + round(lost))
        if missing <= PLAUSIBLE_MISSING + unreadable:
            lines += missing - unreadable
            self._period_ns += LEARNING * (passed_ns / lines - self._period_ns)
        return device_ns, missing, False

    def _follows(self, passed_ns: int | None, lines: int) -> bool:
        """Return whether so many lines, or not many more, can have come in that time."""
        most_ns = (lines + PLAUSIBLE_MISSING) * self._period_ns + self._quantum_ns
        return passed_ns is not None and passed_ns <= most_ns


class TextDecoder:
    """Decoder of a device's lines, from chunks of any size. Pure.

    Everything up to the first line end is discarded, since it may be a part of a line. columns:
    indices of the values among the numbers after the time, from 0; one for each channel. time_unit:
    of a line's first number; None where lines have no time.
    """

    def __init__(self, period_ns: int, columns: Sequence[int], time_unit: TimeUnit | None) -> None:
        self._period_ns = period_ns
        self._columns = columns
        self._unit = time_unit
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Start anew with the next bytes, for example after the cable was unplugged."""
        self._buffer = b""
        self._skipping = self._synchronised = False
        # Rejected lines since the last accepted one.
        self._unreadable = 0
        self._times = LineTimes(self._period_ns, self._unit) if self._unit else None

    def feed(self, data: bytes) -> list[DecodedBlock]:
        """Return the blocks that these bytes complete; consecutive lines form one block."""
        *whole, rest = (self._buffer + data).replace(b"\r", b"\n").split(b"\n")
        samples = []
        for line in whole:
            if line and not self._skipping and not self._synchronised:
                self._reject("partial")
            elif line.strip() and not self._skipping:
                try:
                    samples.append(self._decode(line))
                    self._unreadable = 0
                except WireError as error:
                    self._reject(error.cause)
            self._skipping, self._synchronised = False, True
        if len(rest) > MAX_LINE_BYTES:
            if not self._skipping:
                self._reject("framing" if self._synchronised else "partial")
            self._skipping, rest = True, b""
        self._buffer = rest
        return join_samples(samples)

    def _reject(self, cause: str) -> None:
        self.rejected[cause] += 1
        # A partial line at the start does not count as a lost sample.
        self._unreadable += cause != "partial"

    def _decode(self, line: bytes) -> tuple[Sequence[float], int | None, int, bool]:
        """Return a line's values, time, missing and restarted. Raises WireError with the cause."""
        fields = [field.rpartition(b":")[2] for field in _BETWEEN.split(line.strip())]
        # A time comes first.
        numbers = fields[self._times is not None :]
        if max(self._columns) >= len(numbers):
            raise WireError("not_a_number", f"{line[:40]!r} has no column {max(self._columns)}")
        values = [_number(numbers[column]) for column in self._columns]
        if self._times is None:
            return values, None, self._unreadable, False
        return values, *self._times.take(_number(fields[0]), self._unreadable)


def _number(field: bytes) -> float:
    """Return the number in a field. Raises WireError."""
    try:
        value = float(field)
    except ValueError:
        value = math.nan
    if not is_usable(value):
        raise WireError("not_a_number", f"{field[:40]!r} is no number that can be used")
    return value
