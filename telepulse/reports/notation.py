"""Notation of numbers, units and references in reports: one for all pages and their plots.

Tables of a terminal and of JSON keep plain numbers such as 9.4249e-9, which programs can read.
`typeset` turns such a text into that of a page: 9.4249×10⁻⁹, a true minus, and spaces at which no
line breaks between a number and its unit.
"""

import re

# Units after a number, the longest first, so that "ms" is not taken for "m".
UNITS = sorted(
    (
        *("%", "s", "ms", "µs", "ns", "min", "Hz", "kHz", "/s", "/min", "1/s", "rad/s", "ppm"),
        *("N", "mN", "N/s", "N/m", "N/mm", "N/N", "N/m²", "N·s/m", "N²/Hz", "mmHg", "cm²", "kB/s"),
        *("Pa", "kPa", "MPa", "GPa", "m", "mm", "µm", "mm/s", "m/s", "V", "mV", "mV/N", "pC/N"),
        *("V·m/N", "kg", "digits", "ticks", "beats", "beats/min", "samples", "JND", "microsteps"),
    ),
    key=len,
    reverse=True,
)
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
FIXED_SPACE = "\u00a0"
# A power of ten as programs write it. No hash of hexadecimal digits looks like it.
_POWER = re.compile(r"(?<![\w.])(\d{1,17}(?:\.\d+)?)e([+−-]?)0*(\d{1,3})(?!\w|\.\d)")
_MINUS = re.compile(r"(?<![^\s(/“=:,;–≥≤<>])-(?=[\d∞])")
_PER_CENT = re.compile(r"(?<=\d)%")
_UNIT = re.compile(rf"(?<=\d) (?=(?:{'|'.join(map(re.escape, UNITS))})(?![\w/²·]))")
_BETWEEN = re.compile(r"(?<=\d) ([−±×]) (?=[\d∞])")
_EQUAL = re.compile(r"(?<=\w) = (?=[−\d])")
_NUMBERED = re.compile(r"\b(Figs?\.?|[Ee]qs?|Tables?|[Ss]ections?) (?=\d)")


def typeset(text: str) -> str:
    """Return a plain text with its numbers and units as on a printed page."""
    text = _MINUS.sub("−", _POWER.sub(_power, text))
    text = _UNIT.sub(FIXED_SPACE, _PER_CENT.sub(" %", text))
    text = _EQUAL.sub(f"{FIXED_SPACE}={FIXED_SPACE}", text)
    text = _BETWEEN.sub(rf"{FIXED_SPACE}\1{FIXED_SPACE}", text)
    return _NUMBERED.sub(rf"\1{FIXED_SPACE}", text)


def _power(found: re.Match[str]) -> str:
    mantissa, sign, exponent = found.groups()
    if not float(mantissa):
        return "0"
    power = f"10{('-' if sign in ('-', '−') else '')}{exponent or '0'}"
    power = power[:2] + power[2:].translate(SUPERSCRIPTS)
    return power if mantissa == "1" else f"{mantissa}×{power}"


def percent(share: float, form: str = ".1f") -> str:
    """Return a share in per cent, with a space before the sign as in SI."""
    return f"{100 * share:{form}} %"
