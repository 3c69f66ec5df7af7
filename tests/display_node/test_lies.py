"""Drives and films that report what is not so, by the product's own code in virtual time.

The whole table: `make bench ARGS=lies`.
"""

import pytest

from benchmarks.lies import Case, hostile_stream, lied, paper_pulse
from telepulse.emulate.lies import LieKind

PULSE = paper_pulse()


@pytest.mark.parametrize(
    ("kind", "case", "with_film", "hostile", "named"),
    [
        ("tmcl", Case(LieKind.REVERSED, from_start=True), True, False, "not started: the film"),
        ("cia402", Case(LieKind.REVERSED_ENCODER), False, False, "following error"),
        ("tmcl", Case(LieKind.GAIN_ENCODER, "3"), False, True, "following error"),
        ("cia402", Case(LieKind.POSITION_FROZEN), False, True, "following error"),
        ("tmcl", Case(LieKind.POSITION_JUMP, "-0.5 mm"), False, False, "following error"),
        ("tmcl", Case(LieKind.DELAYED, "45 ms"), True, False, "drive: "),
        ("cia402", Case(LieKind.LOST, "1"), True, False, "no answer"),
        ("cia402", Case(LieKind.GARBAGE, "1"), True, False, "garbled"),
        ("cia402", Case(LieKind.GARBAGE, "1"), False, False, "feedback lost"),
        ("tmcl", Case(LieKind.FILM_ZERO), True, True, "the film reads"),
        ("cia402", Case(LieKind.NO_RETRACTION), True, False, "following error"),
    ],
    ids=lambda value: value.name if isinstance(value, Case) else "",
)
def test_a_lie_is_named_before_it_presses_beyond_the_bars(
    kind: str, case: Case, with_film: bool, hostile: bool, named: str
) -> None:
    outcome = lied(case, kind, with_film, hostile_stream if hostile else PULSE)
    assert named in outcome.named
    assert outcome.missed(honest_error_n=0.0, obeys=case.obeys) == []


@pytest.mark.parametrize("from_start", [False, True], ids=["playing", "from the start"])
def test_answers_that_come_twice_change_nothing_that_is_felt(from_start: bool) -> None:
    honest = lied(None, "tmcl", True, hostile_stream)
    outcome = lied(
        Case(LieKind.DUPLICATED, "1", from_start=from_start), "tmcl", True, hostile_stream
    )
    assert outcome.named == ""
    assert outcome.missed(honest.error_n) == []


def test_a_late_film_is_named_before_a_stiff_finger_is_pressed_by_a_loop_that_swings() -> None:
    case = Case(LieKind.FILM_LATE, "20 ms")
    outcome = lied(case, "tmcl", True, hostile_stream, finger=3.0)
    assert "feedback late" in outcome.named
    assert outcome.missed(honest_error_n=0.0) == []
