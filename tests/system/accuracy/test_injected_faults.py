"""The product's code in virtual time, with drives and films that report false values.

`make bench ARGS=injected_faults` runs all kinds of faults.
"""

import pytest

from tests.support.fault_injection import FaultKind
from tests.support.fault_runs import FaultCase, hostile_stream, paper_pulse, run_fault

PULSE = paper_pulse()
REVERSED = FaultCase(FaultKind.REVERSED, from_start=True)


@pytest.mark.parametrize(
    ("kind", "case", "with_film", "hostile", "named"),
    [
        ("tmcl", REVERSED, True, False, "not started: the force"),
        ("cia402", FaultCase(FaultKind.REVERSED_ENCODER), False, False, "following error"),
        ("tmcl", FaultCase(FaultKind.GAIN_ENCODER, "3"), False, True, "following error"),
        ("cia402", FaultCase(FaultKind.POSITION_FROZEN), False, True, "following error"),
        ("tmcl", FaultCase(FaultKind.POSITION_JUMP, "-0.5 mm"), False, False, "following error"),
        ("tmcl", FaultCase(FaultKind.DELAYED, "45 ms"), True, False, "drive: "),
        ("cia402", FaultCase(FaultKind.LOST, "1"), True, False, "no answer"),
        ("cia402", FaultCase(FaultKind.GARBAGE, "1"), True, False, "garbled"),
        ("cia402", FaultCase(FaultKind.GARBAGE, "1"), False, False, "garbled"),
        ("tmcl", FaultCase(FaultKind.FILM_ZERO), True, True, "film: it reads"),
        ("cia402", FaultCase(FaultKind.NO_RETRACTION), True, False, "following error"),
        ("stepdir", REVERSED, True, False, "not started: the force"),
        ("stepdir", FaultCase(FaultKind.POSITION_JUMP, "-0.5 mm"), False, False, "following error"),
        ("stepdir", FaultCase(FaultKind.DELAYED, "45 ms"), True, False, "feedback l"),
        ("stepdir", FaultCase(FaultKind.LOST, "1"), True, False, "feedback lost"),
        ("stepdir", FaultCase(FaultKind.GARBAGE, "1"), False, False, "garbled"),
        ("stepdir", FaultCase(FaultKind.FILM_ZERO), True, True, "film: it reads"),
    ],
    ids=lambda value: value.kind.value if isinstance(value, FaultCase) else "",
)
def test_a_false_value_is_named_before_the_finger_is_pressed_beyond_the_bounds(
    kind: str, case: FaultCase, with_film: bool, hostile: bool, named: str
) -> None:
    outcome = run_fault(case, kind, with_film, hostile_stream if hostile else PULSE)
    assert named in outcome.named
    assert outcome.missed(faultless_error_n=0.0, obeys=case.obeys) == []


@pytest.mark.parametrize("from_start", [False, True], ids=["playing", "from the start"])
def test_answers_that_come_twice_change_nothing_that_is_felt(from_start: bool) -> None:
    faultless = run_fault(None, "tmcl", True, hostile_stream)
    outcome = run_fault(
        FaultCase(FaultKind.DUPLICATED, "1", from_start=from_start), "tmcl", True, hostile_stream
    )
    assert outcome.named == ""
    assert outcome.missed(faultless.error_n) == []


def test_a_late_film_is_named_before_the_loop_oscillates_at_a_stiff_finger() -> None:
    case = FaultCase(FaultKind.FILM_LATE, "20 ms")
    outcome = run_fault(case, "tmcl", True, hostile_stream, finger=3.0)
    assert "feedback late" in outcome.named
    assert outcome.missed(faultless_error_n=0.0) == []


def test_half_the_gain_of_film_or_motor_and_half_the_stiffness_look_the_same() -> None:
    """Only their product can be estimated; it is shown."""
    film = run_fault(FaultCase(FaultKind.FILM_SCALED, "0.5"), "tmcl", True, PULSE)
    motor = run_fault(FaultCase(FaultKind.GAIN, "0.5"), "tmcl", True, PULSE)
    finger = run_fault(None, "tmcl", True, PULSE, finger=0.5)
    for outcome in (film, motor, finger):
        assert outcome.stiffness == pytest.approx(0.5, abs=0.05)
        assert (outcome.named, outcome.warned) == ("", "")
    # The felt forces differ, which only the film measures.
    assert film.most_n == pytest.approx(2 * finger.most_n, rel=0.1)


def test_a_stiffness_beyond_that_of_fingers_is_an_alert() -> None:
    outcome = run_fault(FaultCase(FaultKind.FILM_SCALED, "5"), "tmcl", True, PULSE)
    assert "implausible for a finger: the film reads too much" in outcome.warned
    for finger in (0.3, 3.0):
        faultless = run_fault(None, "tmcl", True, PULSE, finger=finger)
        assert faultless.stiffness == pytest.approx(finger, rel=0.1)
        assert (faultless.named, faultless.warned) == ("", "")
