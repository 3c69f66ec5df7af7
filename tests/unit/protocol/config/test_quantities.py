import math

import pytest

from protocol.config.quantities import UNITS, parse_quantity, parse_ratio

# A second copy, so that a mistake in the product's table is detected.
EACH_UNIT = {
    "time": {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1, "min": 60},
    "frequency": {"/min": 1 / 60, "Hz": 1, "kHz": 1e3, "MHz": 1e6},
    "bit rate": {"bit/s": 1, "kbit/s": 1e3, "Mbit/s": 1e6},
    "length": {"nm": 1e-9, "um": 1e-6, "µm": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1},
    "force": {"mN": 1e-3, "N": 1},
    "force rate": {"mN/s": 1e-3, "N/s": 1},
    "pressure": {"Pa": 1, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "speed": {"mm/s": 1e-3, "m/s": 1},
    "acceleration": {"mm/s^2": 1e-3, "m/s^2": 1, "mm/s²": 1e-3, "m/s²": 1},
    "stiffness": {"N/m": 1, "N/mm": 1e3},
    "voltage": {"uV": 1e-6, "µV": 1e-6, "mV": 1e-3, "V": 1},
    "sensitivity": {"mV/N": 1e-3, "V/N": 1},
    "angle": {"°": math.pi / 180, "deg": math.pi / 180, "rad": 1},
}


@pytest.mark.parametrize("dimension", UNITS)
def test_every_unit_is_converted(dimension: str) -> None:
    assert UNITS[dimension].keys() == EACH_UNIT[dimension].keys()
    for unit, factor in EACH_UNIT[dimension].items():
        assert parse_quantity(f"2.5 {unit}", dimension) == pytest.approx(2.5 * factor, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("40 ms", 0.04), ("40ms", 0.04), ("  40  ms ", 0.04), ("+40 ms", 0.04), ("-40 ms", -0.04),
        ("4e1 ms", 0.04), ("4.E+1 ms", 0.04), (".5 s", 0.5), ("0 s", 0), ("-0.0 s", 0),
    ],
)  # fmt: skip
def test_ways_to_write_a_number(text: str, seconds: float) -> None:
    assert parse_quantity(text, "time") == pytest.approx(seconds)


@pytest.mark.parametrize("dimension", UNITS)
@pytest.mark.parametrize(
    "text", ["", " ", "40", 40, 40.0, True, None, ["40 ms"], "ms", "forty ms", "40 parsec"]
)
def test_an_invalid_quantity_is_refused_with_the_units(text: object, dimension: str) -> None:
    with pytest.raises(ValueError, match="is a number and one of") as caught:
        parse_quantity(text, dimension)
    line = str(caught.value)
    assert repr(text) in line
    assert dimension in line
    assert ", ".join(UNITS[dimension]) in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("text", "dimension"),
    [
        *[("1 mm", "force"), ("1 N", "length"), ("1 s", "frequency"), ("1 HZ", "frequency")],
        *[("nan ms", "time"), ("inf ms", "time"), ("-inf s", "time"), ("infinity s", "time")],
        *[("1,5 ms", "time"), ("1 2 ms", "time"), ("1 ms ms", "time"), ("0x1 ms", "time")],
    ],
)
def test_another_unit_and_an_invalid_number_are_refused(text: str, dimension: str) -> None:
    with pytest.raises(ValueError, match=f"is no {dimension}"):
        parse_quantity(text, dimension)


@pytest.mark.parametrize("text", ["1e999 s", "-1e999 s", "1e300 s", "9" * 400 + " min"])
def test_a_quantity_above_1e100_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="too large"):
        parse_quantity(text, "time")


# One pass takes microseconds. With the cube of the length, each takes longer than any test may.
@pytest.mark.parametrize(
    "text", ["1" * 20_000 + " x y", " " * 20_000, "1." + "0" * 20_000 + "e ? ?"]
)
def test_a_long_text_is_refused_in_one_pass(text: str) -> None:
    for parse in (parse_ratio, lambda text: parse_quantity(text, "time")):
        with pytest.raises(ValueError, match="is no") as caught:
            parse(text)
        assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    ("text", "ratio"),
    [
        (0, 0), (1, 1), (0.01, 0.01), (1e-7, 1e-7), (-0.5, -0.5), ("0.01", 0.01), ("1 %", 0.01),
        ("12.5%", 0.125), (" 100 % ", 1),
    ],
)  # fmt: skip
def test_a_ratio_is_a_number_or_a_percentage(text: object, ratio: float) -> None:
    assert parse_ratio(text) == pytest.approx(ratio, rel=1e-15)


@pytest.mark.parametrize(
    "text", [math.nan, math.inf, -math.inf, "nan", "inf %", True, None, [1], "", "%", "1 ms", "one"]
)
def test_an_invalid_ratio_is_refused_with_valid_ones(text: object) -> None:
    with pytest.raises(ValueError, match=r"is no ratio: write 0.01 or '1 %'"):
        parse_ratio(text)


@pytest.mark.parametrize("text", [10**400, "1e999", "1e999 %", 1e300], ids=lambda t: str(t)[:8])
def test_a_ratio_above_1e100_is_refused(text: object) -> None:
    with pytest.raises(ValueError, match="too large"):
        parse_ratio(text)
