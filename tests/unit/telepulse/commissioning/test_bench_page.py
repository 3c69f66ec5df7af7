"""The page on the bench states the bounds that the checks apply."""

from collections import Counter

import pytest

from telepulse.commissioning import actuator_check, bench_check, rig, sensor_check, tuning
from telepulse.commissioning.rig import judge_line_errors
from tests.support.nodes import ROOT

PAGE = (ROOT / "docs" / "bench.md").read_text("utf-8")
ROWS = {
    cells[2].strip(): [cell.strip() for cell in cells[3:5]]
    for line in PAGE.splitlines()
    if line.startswith("|") and len(cells := line.split("|")) == 7
}


@pytest.mark.parametrize(
    ("check", "warn", "fail"),
    [
        (
            "noise",
            f"{sensor_check.NOISE_WARN_N * 1e3:g} mN",
            f"{sensor_check.NOISE_FAIL_N * 1e3:g} mN",
        ),
        ("mains", f"{sensor_check.MAINS_WARN * 100:g} %", ""),
        (
            "age of a reading",
            f"{bench_check.FILM_AGE_WARN_S * 1e3:g} ms",
            f"{bench_check.FILM_AGE_FAIL_S * 1e3:g} ms",
        ),
        ("drive's answer", f"{rig.ANSWER_WARN_S * 1e3:g} ms", f"{rig.ANSWER_FAIL_S * 1e3:g} ms"),
        (
            "eq 22",
            f"{actuator_check.UNEXPLAINED_WARN * 100:g} %",
            f"{actuator_check.UNEXPLAINED_FAIL * 100:g} %",
        ),
        (
            "travel",
            f"{actuator_check.TRAVEL_WARN * 100:g} %",
            f"{actuator_check.TRAVEL_FAIL * 100:g} %",
        ),
        ("finger", f"{actuator_check.FINGER_WARN * 100:g} %", ""),
        ("margins", f"Ms of {tuning.MOST_SENSITIVITY:g}", "an unstable loop"),
    ],
)
def test_the_bounds_of_a_check_are_those_on_the_page(check: str, warn: str, fail: str) -> None:
    assert ROWS[check] == [warn, fail]


def test_errors_of_the_line_are_named_and_superseded_commands_are_none() -> None:
    counts = Counter({"wrong": 1, "superseded": 40, "garbled": 2, "not closed": 0})
    checks = judge_line_errors(counts)
    assert [(check.name, check.text, check.verdict) for check in checks] == [
        ("line errors", "2 answers with a wrong checksum", "warn"),
        ("line errors", "1 answer to another request", "warn"),
    ]
