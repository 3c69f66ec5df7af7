"""Readings of a real film: their age, and those that cannot be true."""

import math

import pytest

from display_node.plant.feedback import (
    KEEP,
    SOFTEST,
    WITHIN_NS,
    Feedback,
    FilmPlausibility,
    RisingForce,
)
from tests.support.drive_benches import LAYER, stepper

MS = 1_000_000
LAW = stepper(fingertip="1 N/mm").contact(LAYER)


def contradiction(position_m: float, force_n: float, ms: int = 200) -> str | None:
    film = FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER)
    found = None
    for at_ms in range(0, ms, 5):
        film.add_position(position_m, at_ms * MS)
        found = film.check_reading(force_n, at_ms * MS)
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
        film.add_position(LAW.position(2.5), at_ms * MS)
        right = at_ms % 40 == 0
        assert film.check_reading(2.5 if right else 0.0, at_ms * MS) is None


def test_a_motion_within_50_ms_is_not_held_against_it() -> None:
    film = FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER)
    for at_ms in range(0, 500, 5):
        film.add_position(LAW.position(2.5 if at_ms % 40 else 0.0), at_ms * MS)
        assert film.check_reading(1e-4 * (at_ms % 10), at_ms * MS) is None


def rise(n_per_s: float, end_n: float = 3.5) -> str | None:
    """Return the fault on the way of a ramp to its end."""
    rising, ms, found = RisingForce(2.7, 50.0, 8 * MS), 0, None
    while found is None and n_per_s * ms * 1e-3 <= end_n:
        found = rising.check_reading(n_per_s * ms * 1e-3, ms * MS)
        ms += 1
    return found


@pytest.mark.parametrize("n_per_s", [80.0, 100.0, 150.0])
def test_one_that_rises_faster_is_named_while_there_is_time_to_turn(n_per_s: float) -> None:
    fault = rise(n_per_s)
    assert fault is not None
    at_n = float(fault.split(" at ")[1].split(" N")[0])
    # The film is 8 ms late, and the motor turns 3 ms after that.
    assert at_n + n_per_s * 11e-3 < 1.25 * 2.5


def test_a_force_that_rises_as_commanded_and_a_short_jump_of_noise_are_no_fault() -> None:
    assert rise(10.0, end_n=2.5) is None
    assert rise(50.4, end_n=2.5) is None
    rising = RisingForce(2.7, 50.0, 8 * MS)
    for ms in range(200):
        assert rising.check_reading(0.3 + 0.1 * (ms % 7 == 0), ms * MS) is None


def test_a_film_that_does_not_change_while_the_tip_goes_is_frozen() -> None:
    frozen, right = (FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER) for _ in range(2))
    found = None
    for at_ms in range(0, 600, 5):
        place_m = 0.9e-3 + 0.3e-3 * math.sin(at_ms / 50)
        for film, force_n in ((frozen, 0.55), (right, LAW.force(place_m))):
            film.add_position(place_m, at_ms * MS)
            fault = film.check_reading(force_n, at_ms * MS)
            if film is right:
                assert fault is None
            found = found or fault
    assert "the film reads 550 mN unchanged" in str(found)


def test_a_film_off_the_finger_may_read_the_same_for_ever() -> None:
    film = FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER)
    for at_ms in range(0, 2_000, 5):
        film.add_position(-0.3e-3 + 0.3e-3 * math.sin(at_ms / 50), at_ms * MS)
        assert film.check_reading(0.0, at_ms * MS) is None


def sampled(latency_ms: float = 4, stale_after_ms: float = 20) -> Feedback:
    """Samples of 0 … 9 N at 0 … 9 ms."""
    feedback = Feedback(round(latency_ms * MS), round(stale_after_ms * MS))
    for number in range(10):
        feedback.add(number * MS, float(number))
    return feedback


@pytest.mark.parametrize(
    ("now_ms", "force_n"), [(4, 0), (4.5, 0.5), (9, 5), (12.75, 8.75), (13, 9), (14, 9), (29, 9)]
)
def test_it_returns_the_force_at_the_fixed_age(now_ms: float, force_n: float) -> None:
    assert sampled().read(round(now_ms * MS)) == pytest.approx(force_n, abs=1e-9)


def test_batches_are_read_as_regularly_as_they_were_taken() -> None:
    feedback, read = Feedback(10 * MS, 50 * MS), []
    for now_ms in range(100):
        if now_ms % 8 == 7:
            for taken_ms in range(now_ms - 7, now_ms + 1):
                feedback.add(taken_ms * MS, float(taken_ms))
        read.append(feedback.read(now_ms * MS))
    assert read[20:] == [float(now_ms - 10) for now_ms in range(20, 100)]


def test_before_the_first_sample_and_after_too_long_a_silence_it_reads_nothing() -> None:
    assert math.isnan(Feedback(0, MS).read(0))
    feedback = sampled()
    assert feedback.read(29 * MS) == 9.0
    assert math.isnan(feedback.read(29 * MS + 1))
    assert not feedback.alive(29 * MS + 1)
    assert feedback.silent_fault(29 * MS + 1) == "feedback lost"
    feedback.add(30 * MS, 3.0)
    assert feedback.read(35 * MS) == 3.0


def test_samples_that_are_not_newer_are_counted_and_left_out() -> None:
    feedback = sampled()
    feedback.add(9 * MS, 99.0)
    feedback.add(2 * MS, 99.0)
    assert (feedback.samples, feedback.out_of_order) == (10, 2)
    assert feedback.read(13 * MS) == 9.0
    # A flood is bounded, and the newest is kept.
    feedback = Feedback(MS, 20 * MS)
    for number in range(3 * KEEP):
        feedback.add(number * 1000, float(number))
    assert feedback.read(3 * KEEP * 1000 + MS) == 3 * KEEP - 1


def late_after_ms(ages_ms: list[float], latency_ms: int = 8, stall_ms: int = 0) -> int | None:
    """When readings of these ages, every 2 ms and after a stall of the loop, are a fault."""
    feedback = Feedback(latency_ms * MS, 40 * MS)
    for tick, age_ms in enumerate(ages_ms):
        now_ms = 1_000 + 2 * tick + (stall_ms if tick else 0)
        feedback.add(round((now_ms - age_ms) * MS), 0.3)
        feedback.read(now_ms * MS)
        if feedback.late_fault is not None:
            assert feedback.late_fault == "feedback late: readings are 19 ms old or older, not 8 ms"
            return 2 * tick
    return None


def test_readings_that_are_all_older_than_assumed_are_a_fault() -> None:
    assert late_after_ms([21, 19] * 100) == 100
    # As old as assumed, delivered every 16 ms, or late for less than 100 ms.
    assert late_after_ms([13.0] * 200) is None
    assert late_after_ms([float(2 * (tick % 8)) for tick in range(200)], latency_ms=4) is None
    assert late_after_ms(([19.0] * 49 + [9.0]) * 4) is None
    # Nor is a loop that stood still: it has seen few readings.
    assert late_after_ms([19.0] * 19, stall_ms=500) is None
