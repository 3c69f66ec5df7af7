"""A film that cannot be right where the tip stands."""

import math

import pytest

from display_node.control.film_plausibility import SOFTEST, WITHIN_NS, FilmPlausibility, RisingForce
from tests.support.drive_benches import LAYER, stepper

MS = 1_000_000
LAW = stepper(fingertip="1 N/mm").contact(LAYER)


def contradiction(position_m: float, force_n: float, ms: int = 200) -> str | None:
    film = FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER)
    found = None
    for at_ms in range(0, ms, 5):
        film.report(position_m, at_ms * MS)
        found = film.contradiction(force_n, at_ms * MS)
    return found


@pytest.mark.parametrize("force_n", [0.0, 0.1, 0.5, 1.0, 2.5])
@pytest.mark.parametrize("finger", [SOFTEST, 1.0, 4.0])
def test_no_finger_that_a_person_has_is_a_contradiction(force_n: float, finger: float) -> None:
    place_m = stepper(fingertip=f"{finger} N/mm").contact(LAYER).position(force_n)
    for nearer_m in (-0.4e-3, 0.0, 0.4e-3):
        assert contradiction(place_m + nearer_m, force_n) is None


def test_a_film_that_reads_zero_is_one_before_the_force_limit() -> None:
    at_limit_m = LAW.position(2.5)
    assert "the film reads 0 mN where the tip presses with" in str(contradiction(at_limit_m, 0.0))
    assert contradiction(LAW.position(0.7), 0.0) is not None


def test_a_film_that_is_pressed_far_off_the_finger_is_one() -> None:
    found = contradiction(-2e-3, 0.3)
    assert found == "the film reads 300 mN where the tip is 2.0 mm off the finger"
    assert contradiction(-0.8e-3, 0.3) is None


def test_it_must_last() -> None:
    assert contradiction(LAW.position(2.5), 0.0, ms=WITHIN_NS // MS) is None
    film = FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER)
    for at_ms in range(0, 500, 5):
        film.report(LAW.position(2.5), at_ms * MS)
        right = at_ms % 40 == 0
        assert film.contradiction(2.5 if right else 0.0, at_ms * MS) is None


def test_a_motion_within_50_ms_is_not_held_against_it() -> None:
    film = FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER)
    for at_ms in range(0, 500, 5):
        film.report(LAW.position(2.5 if at_ms % 40 else 0.0), at_ms * MS)
        assert film.contradiction(1e-4 * (at_ms % 10), at_ms * MS) is None


def rise(n_per_s: float, end_n: float = 3.5) -> str | None:
    """Return the fault on the way of a ramp to its end."""
    rising, ms, found = RisingForce(2.7, 50.0, 8 * MS), 0, None
    while found is None and n_per_s * ms * 1e-3 <= end_n:
        found = rising.fault(n_per_s * ms * 1e-3, ms * MS)
        ms += 1
    return found


def test_a_force_that_rises_as_commanded_is_no_fault() -> None:
    assert rise(10.0, end_n=2.5) is None
    assert rise(50.4, end_n=2.5) is None


@pytest.mark.parametrize("n_per_s", [80.0, 100.0, 150.0])
def test_one_that_rises_faster_is_named_while_there_is_time_to_turn(n_per_s: float) -> None:
    fault = rise(n_per_s)
    assert fault is not None
    at_n = float(fault.split(" at ")[1].split(" N")[0])
    # The film is 8 ms late, and the motor turns 3 ms after that.
    assert at_n + n_per_s * 11e-3 < 1.25 * 2.5


def test_a_short_jump_of_noise_is_none() -> None:
    rising = RisingForce(2.7, 50.0, 8 * MS)
    for ms in range(200):
        assert rising.fault(0.3 + 0.1 * (ms % 7 == 0), ms * MS) is None


def test_a_film_that_does_not_change_while_the_tip_goes_is_frozen() -> None:
    frozen, right = (FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER) for _ in range(2))
    found = None
    for at_ms in range(0, 600, 5):
        place_m = 0.9e-3 + 0.3e-3 * math.sin(at_ms / 50)
        for film, force_n in ((frozen, 0.55), (right, LAW.force(place_m))):
            film.report(place_m, at_ms * MS)
            fault = film.contradiction(force_n, at_ms * MS)
            if film is right:
                assert fault is None
            found = found or fault
    assert "the film reads 550 mN all along" in str(found)


def test_a_film_off_the_finger_may_read_the_same_for_ever() -> None:
    film = FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER)
    for at_ms in range(0, 2_000, 5):
        film.report(-0.3e-3 + 0.3e-3 * math.sin(at_ms / 50), at_ms * MS)
        assert film.contradiction(0.0, at_ms * MS) is None
