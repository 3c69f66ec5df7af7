"""Drives and films that report what is not so, by the product's own code in virtual time.

The whole table: `make bench ARGS=lies`.
"""

import pytest

from benchmarks.lies import Case, hostile_stream, lied, paper_pulse
from telepulse.emulators.fault_injection import FaultKind

PULSE = paper_pulse()


@pytest.mark.parametrize(
    ("kind", "case", "with_film", "hostile", "named"),
    [
        (
            "tmcl",
            Case(FaultKind.REVERSED, from_start=True),
            True,
            False,
            "not started: the film",
        ),
        ("cia402", Case(FaultKind.REVERSED_ENCODER), False, False, "following error"),
        ("tmcl", Case(FaultKind.GAIN_ENCODER, "3"), False, True, "following error"),
        ("cia402", Case(FaultKind.POSITION_FROZEN), False, True, "following error"),
        ("tmcl", Case(FaultKind.POSITION_JUMP, "-0.5 mm"), False, False, "following error"),
        ("tmcl", Case(FaultKind.DELAYED, "45 ms"), True, False, "drive: "),
        ("cia402", Case(FaultKind.LOST, "1"), True, False, "no answer"),
        ("cia402", Case(FaultKind.GARBAGE, "1"), True, False, "garbled"),
        ("cia402", Case(FaultKind.GARBAGE, "1"), False, False, "feedback lost"),
        ("tmcl", Case(FaultKind.FILM_ZERO), True, True, "the film reads"),
        ("cia402", Case(FaultKind.NO_RETRACTION), True, False, "following error"),
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
        Case(FaultKind.DUPLICATED, "1", from_start=from_start), "tmcl", True, hostile_stream
    )
    assert outcome.named == ""
    assert outcome.missed(honest.error_n) == []


def test_a_late_film_is_named_before_a_stiff_finger_is_pressed_by_a_loop_that_swings() -> None:
    case = Case(FaultKind.FILM_LATE, "20 ms")
    outcome = lied(case, "tmcl", True, hostile_stream, finger=3.0)
    assert "feedback late" in outcome.named
    assert outcome.missed(honest_error_n=0.0) == []


def test_half_a_film_half_a_motor_and_half_a_finger_look_the_same() -> None:
    """Only their product can be learnt, and it is shown."""
    film = lied(Case(FaultKind.FILM_SCALED, "0.5"), "tmcl", True, PULSE)
    motor = lied(Case(FaultKind.GAIN, "0.5"), "tmcl", True, PULSE)
    finger = lied(None, "tmcl", True, PULSE, finger=0.5)
    for outcome in (film, motor, finger):
        assert outcome.stiffness == pytest.approx(0.5, abs=0.05)
        assert (outcome.named, outcome.warned) == ("", "")
    # What differs is what is felt, and nothing measures that but the film.
    assert film.most_n == pytest.approx(2 * finger.most_n, rel=0.1)


def test_a_stiffness_that_no_finger_has_is_an_alert() -> None:
    outcome = lied(Case(FaultKind.FILM_SCALED, "5"), "tmcl", True, PULSE)
    assert "implausible for a finger: the film reads too much" in outcome.warned
    for finger in (0.3, 3.0):
        honest = lied(None, "tmcl", True, PULSE, finger=finger)
        assert honest.stiffness == pytest.approx(finger, rel=0.1)
        assert (honest.named, honest.warned) == ("", "")
