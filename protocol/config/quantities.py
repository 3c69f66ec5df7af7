"""Quantities as people write them ("40 ms", "0.3 N", "75 /min") read into SI numbers; names.

A scene file states the unit in the value, the code in the name: the key `delay = "40 ms"` becomes
the field `delay_ns`.
"""

import math
import re
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field

MAX_NAME = 80


def _printable(name: str) -> str:
    if not name.isprintable():
        raise ValueError("holds characters that a terminal cannot show")
    return name


Name = Annotated[
    str, Field(strict=True, min_length=1, max_length=MAX_NAME), AfterValidator(_printable)
]
"""Name of a stream, a channel or a contactor, which is shown in terminals."""


def count_text(count: int, singular: str, plural: str | None = None) -> str:
    """Return a count with its noun: "1 sample", "2 samples"; the plural adds an s by default."""
    return f"{count} {singular if count == 1 else plural or singular + 's'}"


UNITS: dict[str, dict[str, float]] = {
    "time": {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0},
    "frequency": {"/min": 1 / 60, "Hz": 1.0, "kHz": 1e3, "MHz": 1e6},
    "bit rate": {"bit/s": 1.0, "kbit/s": 1e3, "Mbit/s": 1e6},
    "length": {"nm": 1e-9, "um": 1e-6, "µm": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "force": {"mN": 1e-3, "N": 1.0},
    "force rate": {"mN/s": 1e-3, "N/s": 1.0},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "speed": {"mm/s": 1e-3, "m/s": 1.0},
    "acceleration": {"mm/s^2": 1e-3, "mm/s²": 1e-3, "m/s^2": 1.0, "m/s²": 1.0},
    "stiffness": {"N/m": 1.0, "N/mm": 1e3},
    "voltage": {"uV": 1e-6, "µV": 1e-6, "mV": 1e-3, "V": 1.0},
    "sensitivity": {"mV/N": 1e-3, "V/N": 1.0},
    "angle": {"°": math.pi / 180, "deg": math.pi / 180, "rad": 1.0},
}
# All quantifiers are possessive, so that a long text without a quantity is refused in one pass.
_NUMBER = re.compile(r"\s*+([-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?+)\s*+(\S*+)\s*+")
_LARGEST = 1e100
_SHOWN = 80


def parse_quantity(text: object, dimension: str) -> float:
    """Read a number and its unit, such as "40 ms", into SI; `dimension` is a key of `UNITS`.

    Raises ValueError with one line that names what is allowed.
    """
    units = UNITS[dimension]
    match = _NUMBER.fullmatch(text) if isinstance(text, str) else None
    if match is None or match[2] not in units:
        raise ValueError(
            f"{shown(text)} is no {dimension}: a {dimension} is a number and one of"
            f" {', '.join(units)}"
        )
    return _sane(float(match[1]) * units[match[2]], text)


def parse_ratio(text: object) -> float:
    """Read a plain number or a percentage ("1 %") as a ratio. Raises ValueError otherwise."""
    match = _NUMBER.fullmatch(str(text)) if isinstance(text, int | float | str) else None
    if match is None or match[2] not in ("", "%"):
        raise ValueError(f"{shown(text)} is no ratio: write 0.01 or '1 %'")
    return _sane(float(match[1]) * (0.01 if match[2] else 1.0), text)


def shown(value: object) -> str:
    """Return a value for an error message, cut if it is long."""
    return f"{value!r:.{_SHOWN}}"


def in_unit_of(value: float, text: object) -> str:
    """Return a value, given in the code's unit, as text in the unit of `text`."""
    match = _NUMBER.fullmatch(text) if isinstance(text, str) else None
    unit = match[2] if match else ""
    for dimension, units in UNITS.items():
        if unit in units:
            ours = 1e-9 if dimension == "time" else 1.0
            return f"{value * ours / units[unit]:g} {unit}"
    return f"{value:g}"


def _sane(value: float, text: object) -> float:
    """Return the value. Raises ValueError if it is too large to be converted."""
    if not abs(value) < _LARGEST:
        raise ValueError(f"{shown(text)} is too large")
    return value


def _reader(dimension: str) -> BeforeValidator:
    return BeforeValidator(lambda text: parse_quantity(text, dimension))


Nanoseconds = Annotated[
    int, BeforeValidator(lambda text: round(parse_quantity(text, "time") * 1e9))
]
Hertz = Annotated[float, _reader("frequency")]
BitsPerSecond = Annotated[float, _reader("bit rate")]
Metres = Annotated[float, _reader("length")]
Newtons = Annotated[float, _reader("force")]
NewtonsPerSecond = Annotated[float, _reader("force rate")]
Pascals = Annotated[float, _reader("pressure")]
MetresPerSecond = Annotated[float, _reader("speed")]
MetresPerSecond2 = Annotated[float, _reader("acceleration")]
NewtonsPerMetre = Annotated[float, _reader("stiffness")]
Volts = Annotated[float, _reader("voltage")]
VoltsPerNewton = Annotated[float, _reader("sensitivity")]
Radians = Annotated[float, _reader("angle")]
Ratio = Annotated[float, BeforeValidator(parse_ratio)]
