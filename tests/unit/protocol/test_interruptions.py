from dataclasses import astuple

import pytest

from protocol.availability import InterruptionCounter, Interruptions


def counted(*ticks: tuple[bool, int]) -> Interruptions:
    counter = InterruptionCounter(1e-3)
    for full, elapsed in ticks:
        counter.add(full, elapsed)
    return counter.interruptions()


def test_before_the_first_tick_nothing_is_known_and_then_there_is_none() -> None:
    assert counted() == Interruptions()
    assert counted((False, 1), (False, 1)) == Interruptions(0, 0.0)
    # A start is none, and neither are missed ticks alone.
    assert counted((False, 1), (True, 1), (True, 50), (True, 1)) == Interruptions(0, 0.0)


def test_an_interruption_is_from_one_full_tick_to_the_next() -> None:
    found = counted((True, 1), (True, 1), (False, 2600), (False, 1), (True, 1), (True, 1))
    assert astuple(found) == pytest.approx((1, 2.602, 2.602, 0.002, 2.604))


def test_one_that_is_not_over_does_not_count_yet() -> None:
    assert counted((True, 1), (False, 500)) == Interruptions(0, 0.0)


def test_several_add_up_and_the_last_has_its_times() -> None:
    found = counted((True, 1), (False, 100), (True, 1), (False, 1), (True, 1))
    assert astuple(found) == pytest.approx((2, 0.103, 0.101, 0.102, 0.104))
