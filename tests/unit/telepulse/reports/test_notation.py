"""The notation of pages: powers of ten, minus signs, and spaces at which no line breaks."""

import pytest

from telepulse.reports.notation import percent, typeset

SPACE = "\u00a0"


@pytest.mark.parametrize(
    ("plain", "printed"),
    [
        ("9.4249e-9 is such an error", "9.4249×10⁻⁹ is such an error"),
        ("rtol 1e-06, 2e+09, 5e-324.", "rtol 10⁻⁶, 2×10⁹, 5×10⁻³²⁴."),
        ("−1e+30, 0.000e+00", "−10³⁰, 0"),
        ("1 − 6.6e-04", f"1{SPACE}−{SPACE}6.6×10⁻⁴"),
        ("-1.5% to +3.0%", f"−1.5{SPACE}% to +3.0{SPACE}%"),
        ("strain of 1 N -4.8e-06", f"strain of 1{SPACE}N −4.8×10⁻⁶"),
        ("5305 mV/N, 40 ms; 75 beats/min", f"5305{SPACE}mV/N, 40{SPACE}ms; 75{SPACE}beats/min"),
        ("r = 9 mm, kp = a", f"r{SPACE}={SPACE}9{SPACE}mm, kp = a"),
        ("Figs 13–14, eq 21, Fig. 4", f"Figs{SPACE}13–14, eq{SPACE}21, Fig.{SPACE}4"),
    ],
)
def test_numbers_are_set_as_on_a_printed_page(plain: str, printed: str) -> None:
    assert typeset(plain) == printed


@pytest.mark.parametrize(
    "text",
    ["2026-11-25 22:11", "run-2", "9d0d24100f44eedca29d4fd8", "v1.0e", "2 minutes", "4 Niels", "–"],
)
def test_what_is_no_number_with_a_unit_stays(text: str) -> None:
    assert typeset(text) == text


def test_a_share_has_a_space_before_its_sign() -> None:
    assert (percent(0.795), percent(0.05, ".0f"), percent(-0.0152, "+.1f")) == (
        "79.5 %",
        "5 %",
        "-1.5 %",
    )
