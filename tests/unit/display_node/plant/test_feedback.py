"""Readings of a real film at a fixed age."""

import math

import pytest

from display_node.plant.feedback import KEEP, Feedback

MS = 1_000_000


def sampled() -> Feedback:
    """Return a feedback with samples of 0 … 9 N at 0 … 9 ms, read at an age of 4 ms."""
    feedback = Feedback(4 * MS, 20 * MS)
    for number in range(10):
        feedback.add(number * MS, float(number))
    return feedback


@pytest.mark.parametrize(
    ("now_ms", "force_n"), [(4, 0), (4.5, 0.5), (9, 5), (12.75, 8.75), (13, 9), (14, 9), (29, 9)]
)
def test_a_reading_has_the_fixed_age(now_ms: float, force_n: float) -> None:
    assert sampled().read(round(now_ms * MS)) == pytest.approx(force_n, abs=1e-9)


def test_batches_are_read_evenly() -> None:
    feedback, read = Feedback(10 * MS, 50 * MS), []
    for now_ms in range(100):
        if now_ms % 8 == 7:
            for taken_ms in range(now_ms - 7, now_ms + 1):
                feedback.add(taken_ms * MS, float(taken_ms))
        read.append(feedback.read(now_ms * MS))
    assert read[20:] == [float(now_ms - 10) for now_ms in range(20, 100)]


def test_without_a_recent_sample_the_reading_is_nan() -> None:
    assert math.isnan(Feedback(0, MS).read(0))
    feedback = sampled()
    assert feedback.read(29 * MS) == 9.0
    assert math.isnan(feedback.read(29 * MS + 1))
    assert not feedback.alive(29 * MS + 1)
    assert str(feedback.silent_fault(29 * MS + 1)) == "film: feedback lost"
    feedback.add(30 * MS, 3.0)
    assert feedback.read(35 * MS) == 3.0


def test_samples_that_are_not_newer_are_counted_and_dropped() -> None:
    feedback = sampled()
    feedback.add(9 * MS, 99.0)
    feedback.add(2 * MS, 99.0)
    assert (feedback.samples, feedback.out_of_order) == (10, 2)
    assert feedback.read(13 * MS) == 9.0
    # Of a flood, only the newest samples are kept.
    feedback = Feedback(MS, 20 * MS)
    for number in range(3 * KEEP):
        feedback.add(number * 1000, float(number))
    assert feedback.read(3 * KEEP * 1000 + MS) == 3 * KEEP - 1


def late_after_ms(ages_ms: list[float], latency_ms: int = 8, stall_ms: int = 0) -> int | None:
    """Return the time of the fault for readings of these ages, every 2 ms after a stall."""
    feedback = Feedback(latency_ms * MS, 40 * MS)
    for tick, age_ms in enumerate(ages_ms):
        now_ms = 1_000 + 2 * tick + (stall_ms if tick else 0)
        feedback.add(round((now_ms - age_ms) * MS), 0.3)
        feedback.read(now_ms * MS)
        if (fault := feedback.late_fault(now_ms * MS)) is not None:
            assert fault.cause == "feedback late: readings are 19 ms old or older, not 8 ms"
            return 2 * tick
    return None


def test_readings_that_are_all_older_than_assumed_are_a_fault() -> None:
    assert late_after_ms([21, 19] * 100) == 100
    # As old as assumed, delivered every 16 ms, or late for less than 100 ms.
    assert late_after_ms([13.0] * 200) is None
    assert late_after_ms([float(2 * (tick % 8)) for tick in range(200)], latency_ms=4) is None
    assert late_after_ms(([19.0] * 49 + [9.0]) * 4) is None
    # A stalled loop has too few readings.
    assert late_after_ms([19.0] * 19, stall_ms=500) is None
