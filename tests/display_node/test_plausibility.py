"""A film that cannot be right where the tip stands."""

import pytest

from display_node.plausibility import SOFTEST, WITHIN_NS, FilmPlausibility

from .drives.benches import LAYER, stepper

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
        assert film.contradiction(0.0, at_ms * MS) is None
