"""Lines of text as a sketch prints them: a value, or the device's time and a value.

Numbers stand between blanks, commas or semicolons; a name before a colon, which plotters like,
is skipped. Lines have no checksum: a wrong digit goes unseen in a value, though not in a time.
"""

import math
import re
from collections import Counter
from dataclasses import replace
from typing import Literal

from protocol.errors import WireError
from pulse_sensors.device_counters import LineTimes
from pulse_sensors.reading import LARGEST, Packet

TimeUnit = Literal["us", "ms", "s"]

MAX_LINE_BYTES = 256
_MICROSECONDS: dict[TimeUnit, float] = {"us": 1.0, "ms": 1e3, "s": 1e6}
# Of times in whole milliseconds, in seconds with three decimals, and of micros() on slow boards.
_QUANTUM_NS: dict[TimeUnit, int] = {"us": 10_000, "ms": 1_000_000, "s": 1_000_000}
_BETWEEN = re.compile(rb"[\s,;]+")


class TextDecoder:
    """Makes packets of a device's lines, however they are cut; what is no sample is counted.

    What came before the first line's end may be the rest of a line, and is not believed.
    """

    def __init__(self, period_ns: int, column: int, time_unit: TimeUnit | None) -> None:
        """Decode lines of numbers.

        period_ns: nominal period of the samples. column: index of the value from 0, the time not
        counted. time_unit: unit of the line's first number; None when lines have no time.
        """
        self._period_ns = period_ns
        self._column = column
        self._unit = time_unit
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Begin anew, as after a cable was pulled."""
        self._buffer = b""
        self._skipping = False
        self._synchronised = False
        self._spoilt = 0
        self._times: LineTimes | None = None
        if self._unit is not None:
            self._times = LineTimes(self._period_ns, _QUANTUM_NS[self._unit])

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that end in these bytes."""
        *whole, rest = (self._buffer + data).replace(b"\r", b"\n").split(b"\n")
        packets = []
        for line in whole:
            if not self._synchronised and line and not self._skipping:
                self.rejected["partial"] += 1
            elif line.strip() and not self._skipping:
                try:
                    packets.append(self._packet(line))
                    self._spoilt = 0
                except WireError as error:
                    self._spoil(error.cause)
            self._skipping, self._synchronised = False, True
        if len(rest) > MAX_LINE_BYTES:
            if not self._skipping and self._synchronised:
                self._spoil("framing")
            elif not self._skipping:
                self.rejected["partial"] += 1
            self._skipping, rest = True, b""
        self._buffer = rest
        return _joined(packets)

    def _spoil(self, cause: str) -> None:
        """Count what is no sample, and stood where one should be."""
        self.rejected[cause] += 1
        self._spoilt += 1

    def _packet(self, line: bytes) -> Packet:
        """Decode one line. Raises WireError with the cause."""
        fields = [field.rpartition(b":")[2] for field in _BETWEEN.split(line.strip())]
        now_us = 0
        if self._unit is not None:
            now_us = round(_number(fields[0]) * _MICROSECONDS[self._unit])
            fields = fields[1:]
        if self._column >= len(fields):
            raise WireError("not_a_number", f"{line[:40]!r} has no column {self._column}")
        value = _number(fields[self._column])
        if self._times is None:
            return Packet((value,), missing=self._spoilt)
        time = self._times.take(now_us, self._spoilt)
        return Packet((value,), *time)


def _joined(packets: list[Packet]) -> list[Packet]:
    """Packets that follow one another as one, with the last one's time: it arrived soonest."""
    joined: list[Packet] = []
    for packet in packets:
        if joined and not packet.missing and not packet.anew:
            values = joined[-1].values + packet.values
            joined[-1] = replace(joined[-1], values=values, device_ns=packet.device_ns)
        else:
            joined.append(packet)
    return joined


def _number(field: bytes) -> float:
    """Return the number in a field. Raises WireError."""
    try:
        value = float(field)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        raise WireError("not_a_number", f"{field[:40]!r} is no number that can be used")
    return value
