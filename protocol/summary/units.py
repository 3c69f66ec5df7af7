"""Units of the summary's figures: in JSON, in a text for people, and for Prometheus."""

from collections.abc import Mapping
from typing import Final, NamedTuple


class Unit(NamedTuple):
    """Unit of a figure: its name in JSON, and the name and the format of a number in a text.

    factor: multiplies the JSON's value for the text. base: multiplies it for Prometheus.
    """

    name: str
    shown: str
    form: str
    factor: float = 1.0
    base: float = 1.0

    def text(self, value: float | None) -> str:
        """Return a value with its unit; empty without a value. One that rounds to 0 has no sign."""
        if value is None:
            return ""
        number = f"{value * self.factor:z{self.form}}" if self.form else f"{value}"
        return f"{number} {self.shown}".rstrip()


COUNT: Final = Unit("", "", "")
NEWTONS: Final = Unit("N", "mN", ".3f", factor=1e3)
SHARE: Final = Unit("share, 0 to 1", "%", ".1f", factor=100.0)
UNITS: Final[Mapping[str, Unit]] = {
    "s": Unit("s", "s", ".2f"),
    "ms": Unit("ms", "ms", ".2f", base=1e-3),
    "µs": Unit("µs", "µs", ".0f", base=1e-6),
    "ppm": Unit("ppm", "ppm", ".1f", base=1e-6),
    "N": NEWTONS,
    "strain": Unit("strain", "", ".3e"),
    "share": SHARE,
    "ratio": Unit("ratio", "", ".2f"),
    "1/min": Unit("1/min", "/min", ".0f", base=1 / 60),
}
