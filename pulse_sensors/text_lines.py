"""Lines of text as an Arduino sketch prints them: values, or the device's time and values.

Numbers are separated by blanks, commas or semicolons. Each may have a label before it and a unit
behind it: "Force: 0.345 N", "IR=51234 RED=40000", "S512". Recordings of such lines are read by the
same functions. Lines have no checksum: a wrong digit is detected in a time, but not in a value.
"""

import logging
import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import Literal, NamedTuple

from protocol.errors import WireError
from pulse_sensors.force_scale import FORCES, VOLTAGES
from pulse_sensors.sample_plausibility import is_usable
from pulse_sensors.samples import QUOTED, DecodedBlock, DeviceTime, join_samples, quoted

logger = logging.getLogger(__name__)

TimeUnit = Literal["us", "ms", "s"]

MAX_LINE_BYTES = 256
# Each unit's length in µs, and the resolution of times in it, in ns. The micros() of slow boards
# counts in 10 µs, times in ms are whole, times in s have three decimals. millis() counts in 1.024
# ms on many boards, and steps by 2 at times. Times with fewer decimals are coarser.
_UNITS: dict[TimeUnit, tuple[float, int]] = {
    "us": (1.0, 10_000),
    "ms": (1e3, 1_000_000),
    "s": (1e6, 1_000_000),
}
# Lines in this time may have the same device time, until its resolution is measured.
STILL_NS = 100_000_000
# Device times that step by more sample periods than this tell less than the times of arrival.
COARSE_PERIODS = 4
COUNTS = "counts"
_BINARY = 'set framing = "binary", or baud to that of the sketch'
_BETWEEN = re.compile(r"[\s,;]+")
_DIGITS = re.compile(r"[-+.\d\s,;]*")
# A gap of more samples than this must be confirmed by the line that follows.
PLAUSIBLE_MISSING = 3
LEARNING = 0.01

_UNIT_WORDS = {
    "volts": "V",
    "millivolts": "mV",
    "microvolts": "uV",
    "newtons": "N",
    "millinewtons": "mN",
}
UNITS = re.compile(
    rf"{'|'.join(_UNIT_WORDS)}|[mµμu]?[NVAg]|kg|[hkm]?Pa|m?bar|mmHg|cmH2O|NU|a\.?u\.?|ad[cu]|counts?|raw|lsb|%|°?C|degC|bpm"
    r"|1/min|k?Hz|m/s[2²]|deg|dps|k?ohm|[mµμun]?s|min",
    re.IGNORECASE,
)
_LABELLED = re.compile(
    r"[\"']?([^\W\d][\w .%/()\[\]-]*?)[\"']?\s*[=:]\s*"
    r"([-+]?(?:\d+(?:[.,]\d+)?(?:e[-+]?\d+)?|nan\b|inf\b))"
    rf"(?:\s*({UNITS.pattern})(?!\s*[=:\w]))?",
    re.IGNORECASE,
)
_LETTERED = re.compile(r"([A-Za-z])([-+]?\d+(?:\.\d+)?)")
MEASURED = re.compile(rf"(.*\d[.,]?)\s*({UNITS.pattern})", re.IGNORECASE)
# Further digits right behind a number, so that it is none.
_BROKEN = re.compile(r"[^\s,;|\]})\"']*\d[^\s,;|\]})\"']*")


# Units of forces and voltages in small letters.
_SYMBOLS = {unit.lower(): unit for unit in (*FORCES, *VOLTAGES, "uV")}
_SYMBOLS |= {"µv": "uV", "μv": "uV"}


class Number(NamedTuple):
    """Number of a line as it stands there, with its label and its unit, or nothing."""

    text: str
    label: str = ""
    unit: str = ""


def labelled_numbers(line: str) -> list[Number]:
    """Return the numbers of a line that have labels; the time before "->" is one."""
    if (lettered := _LETTERED.fullmatch(line.strip())) is not None:
        return [Number(lettered[2], lettered[1])]
    matches = list(_LABELLED.finditer(line)) if "=" in line or ":" in line else []
    ends = [match.start() for match in matches[1:]] + [len(line)]
    found = []
    for match, end in zip(matches, ends, strict=False):
        broken = _BROKEN.match(line, match.end(), end)
        found.append(Number(match[2] + (broken[0] if broken else ""), match[1], match[3] or ""))
    time, arrow, _ = line.partition("->")
    return [Number(time.strip(), "time"), *found] if found and arrow else found


def unit_symbol(unit: str) -> str:
    """Return the symbol of a unit that is a word, such as "Volts"; others as they are."""
    return _UNIT_WORDS.get(unit.lower(), unit)


def numbers_of(line: str) -> list[Number]:
    """Return the numbers of a line, and what stands in the place of one."""
    if _DIGITS.fullmatch(line):
        return [Number(part) for part in _BETWEEN.split(line)]
    labelled = labelled_numbers(line)
    if labelled:
        # A device's time may have no label.
        before = _plain_numbers(line[: line.find(labelled[0].label)].strip(" \t,;\"'"))
        return [each for each in before if _is_number(each.text)] + labelled
    return _plain_numbers(line)


def _plain_numbers(line: str) -> list[Number]:
    found: list[Number] = []
    for part in _BETWEEN.split(line):
        measured = MEASURED.fullmatch(part)
        if found and UNITS.fullmatch(part):
            found[-1] = found[-1]._replace(unit=part)
        elif measured is not None:
            found.append(Number(measured[1], unit=measured[2]))
        else:
            found.append(Number(part))
    return found


class LineTimes:
    """Check of the times of lines sent once a period, for lost lines and wrong digits.

    A time shortly after the last one is accepted. Any other time is rejected; if the next line's
    time follows it, that line is accepted: lines were lost, or the device has restarted. As many
    lines may have the same time as fall into its resolution, which is measured. The true period is
    estimated.

    """

    def __init__(self, period_ns: int, unit: TimeUnit) -> None:
        self._period_ns = float(period_ns)
        self._unit_us, self._usual_ns = _UNITS[unit]
        # Most decimals so far: noise takes some away. Longest step between two times of several
        # lines, and the number of steps.
        self._decimals = self._stepped_ns = self._steps = 0
        self._time = DeviceTime()
        self._suspect: DeviceTime | None = None
        # Lines with the last time, also lost ones.
        self._lines = 1

    @property
    def resolution_ns(self) -> int:
        """Resolution of the times: that of the unit, of the decimals, or of the steps so far."""
        shown_ns = round(self._unit_us * 10.0 ** (3 - self._decimals))
        return max(self._usual_ns, shown_ns, self._stepped_ns)

    @property
    def too_coarse(self) -> bool:
        """True where the times of arrival say more."""
        return self._steps > 1 and self.resolution_ns > COARSE_PERIODS * self._period_ns

    def take(self, text: str, unreadable: int) -> tuple[int, int, bool]:
        """Return a line's `device_ns`, `missing` and `restarted`, as in `DecodedBlock`.

        text: the time, whose decimals bound its resolution. unreadable: count of rejected lines
        directly before it. Raises WireError for a time that is not accepted yet.
        """
        now_us = round(_value(text) * self._unit_us)
        self._decimals = max(self._decimals, len(text.partition(".")[2]))
        lines = self._lines + unreadable
        # Lines come somewhat early or late: half of the resolution is allowed for that.
        longest_ns = max(1.5 * self.resolution_ns, STILL_NS)
        if now_us == self._time.last_us and lines * self._period_ns < longest_ns:
            self._suspect, self._lines = None, lines + 1
            return self._time.last_ns, unreadable, False
        passed_ns = self._time.since_last_ns(now_us)
        if self._time.last_us is not None and not self._follows(passed_ns, lines):
            suspect, self._suspect = self._suspect, DeviceTime()
            self._suspect.take(now_us)
            if suspect is None or not self._follows(suspect.since_last_ns(now_us), 1):
                raise WireError(
                    "device_time",
                    f"the time {text:.20} does not follow the last one; set device_time to its"
                    " unit, or leave it out where the first number is no time",
                )
        self._suspect, self._lines = None, 1
        device_ns = self._time.take(now_us)
        if passed_ns is None:
            return device_ns, 0, True
        lost = passed_ns / self._period_ns - lines
        fits = abs(lost) <= 0.5 + self._tolerance_ns / self._period_ns
        if lines > 1 and not unreadable and self._steps:
            # After several lines with one time, so many periods have passed.
            stepped_ns = min(passed_ns, round(1.5 * lines * self._period_ns))
            self._stepped_ns = max(self._stepped_ns, stepped_ns)
        self._steps += 1
        missing = unreadable if fits else max(0, unreadable + round(lost))
        if missing <= PLAUSIBLE_MISSING + unreadable:
            lines += missing - unreadable
            self._period_ns += LEARNING * (passed_ns / lines - self._period_ns)
        return device_ns, missing, False

    def _follows(self, passed_ns: int | None, lines: int) -> bool:
        """Return whether so many lines, or not many more, can have come in that time."""
        most_ns = (lines + PLAUSIBLE_MISSING) * self._period_ns + self._tolerance_ns
        return passed_ns is not None and passed_ns <= most_ns

    @property
    def _tolerance_ns(self) -> int:
        # The first step begins anywhere, so that the second one shows the resolution.
        return self.resolution_ns if self._steps > 1 else max(self.resolution_ns, STILL_NS)


class TextDecoder:
    """Decoder of a device's lines, from chunks of any size. Pure.

    Everything up to the first line end is discarded, since it may be a part of a line. columns:
    the values by their labels, or by their indices among the numbers after the time, from 0; one
    for each channel. time_unit: of a line's first number; None where lines have no time. units: of
    the channels; a number with another unit of the same kind is converted.

    refused: a sentence for each cause of `rejected`, with its newest line and what to set.
    """

    def __init__(
        self,
        period_ns: int,
        columns: Sequence[int | str],
        time_unit: TimeUnit | None,
        units: Sequence[str] = (),
    ) -> None:
        self._period_ns = period_ns
        self._columns, self._units = columns, units or [COUNTS] * len(columns)
        self._unit = time_unit
        # Whether the device's times are too coarse to be used.
        self._too_coarse = False
        self.rejected: Counter[str] = Counter()
        self.refused: dict[str, str] = {}
        self.reset()

    def reset(self) -> None:
        """Start anew with the next bytes, for example after the cable was unplugged."""
        self._buffer = b""
        self._skipping = self._synchronised = False
        # Rejected lines since the last accepted one.
        self._unreadable = 0
        # Labels of the columns; a second line in a row with the same ones settles them.
        self._labels: list[str] | None = None
        self._is_settled = False
        self._times = LineTimes(self._period_ns, self._unit) if self._unit else None

    def feed(self, data: bytes) -> list[DecodedBlock]:
        """Return the blocks that these bytes complete; consecutive lines form one block."""
        *whole, rest = (self._buffer + data).replace(b"\r", b"\n").split(b"\n")
        samples = []
        for line in whole:
            if line and not self._skipping and not self._synchronised:
                self._reject("partial", line, "has no line end before it")
            elif line.strip() and not self._skipping:
                try:
                    samples.append(self._decode(line))
                    self._unreadable = 0
                except WireError as error:
                    self._reject(error.cause, line, str(error))
            self._skipping, self._synchronised = False, True
        if len(rest) > MAX_LINE_BYTES:
            if not self._skipping:
                cause = "framing" if self._synchronised else "partial"
                self._reject(cause, rest, f"has no line end in {MAX_LINE_BYTES} bytes: {_BINARY}")
            self._skipping, rest = True, b""
        self._buffer = rest
        return join_samples(samples)

    def _reject(self, cause: str, line: bytes, reason: str) -> None:
        # A line of another kind, where the scene names that of its values.
        chosen = cause == "labels" and any(isinstance(each, str) for each in self._columns)
        self.rejected[cause] += not chosen
        # A partial line at the start, or one of another kind, does not count as a lost sample.
        self._unreadable += cause not in ("partial", "labels")
        if not line.decode(errors="replace").replace("\t", " ").isprintable():
            reason = f"is no text: {_BINARY}"
        # The newest is the last one.
        self.refused.pop(cause, None)
        self.refused[cause] = f"the line {quoted(line)} {reason}"

    def _decode(self, line: bytes) -> tuple[Sequence[float], int | None, int, bool]:
        """Return a line's values, time, missing and restarted. Raises WireError with the cause."""
        numbers = numbers_of(line.decode(errors="replace").strip())
        # A time comes first.
        first = self._times is not None
        chosen = [_chosen(numbers[first:], column) for column in self._columns]
        values = [
            _value(number.text) * _factor(number.unit, unit)
            for number, unit in zip(chosen, self._units, strict=True)
        ]
        self._check_labels([number.label for number in chosen])
        if self._times is None or self._too_coarse:
            return values, None, self._unreadable, False
        device_ns, missing, restarted = self._times.take(numbers[0].text, self._unreadable)
        if self._times.too_coarse:
            self._too_coarse = True
            logger.warning(
                f"the device's times step by {self._times.resolution_ns * 1e-6:g} ms, which is too"
                f" coarse for samples each {self._period_ns * 1e-6:g} ms: their times of arrival"
                " are used; let the sketch print micros()"
            )
            return values, None, self._unreadable, False
        return values, device_ns, missing, restarted

    def _check_labels(self, labels: list[str]) -> None:
        """Raise WireError for labels other than those of the lines before."""
        before, self._labels = self._labels, self._labels if self._is_settled else labels
        if before is None:
            return
        if labels == before:
            self._is_settled = True
            return
        names, before_names = (", ".join(filter(None, each)) for each in (labels, before))
        raise WireError(
            "labels",
            f"has {names or 'no label'} where {before_names or 'none'} was: set column to the label"
            f' to be read, as in column = "{names or before_names}"',
        )


def _chosen(numbers: Sequence[Number], column: int | str) -> Number:
    """Return the number of a column. Raises WireError."""
    if isinstance(column, int):
        if column < len(numbers):
            return numbers[column]
        raise WireError(
            "not_a_number",
            f"has no column {column}, which counts from 0: set column, or print one value more",
        )
    found = next((each for each in numbers if each.label == column), None)
    if found is None:
        labels = ", ".join(each.label for each in numbers if each.label)
        raise WireError("labels", f"has no {column!r}, but {labels or 'no label'}: set column")
    return found


def _value(text: str) -> float:
    """Return the number that a text is. Raises WireError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not is_usable(value):
        raise WireError(
            "not_a_number",
            f"has {text[:QUOTED]!r} where a number was expected: set column to the place of"
            " the number, from 0",
        )
    return value


def _is_number(text: str) -> bool:
    return text.replace(".", "", 1).isdecimal()


def _factor(stated: str, unit: str) -> float:
    """Return the factor from a number's unit into the scene's. Raises WireError."""
    symbol = _SYMBOLS.get(unit_symbol(stated).lower(), stated)
    if not stated or symbol == unit or unit == COUNTS:
        return 1.0
    for known in (FORCES, VOLTAGES | {"uV": 1e-6}):
        if symbol in known and unit in known:
            return known[symbol] / known[unit]
    scale = f'set unit = "{symbol}"' if symbol in FORCES | VOLTAGES else "set unit and its scale"
    raise WireError("unit", f'is in {stated}, the scene says unit = "{unit}": {scale}')
