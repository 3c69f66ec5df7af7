import dataclasses
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.counters import (
    STATE_NAMES,
    Availability,
    AvailabilityCounter,
    InterruptionCounter,
    Interruptions,
    availability_text,
)

TICK_S = 1e-3
STATES = ["playing", "starting", "stale", "fault", "waiting", "ended"]
runs = st.lists(st.tuples(st.sampled_from(STATES), st.integers(1, 50)), min_size=1, max_size=300)


def counted(*ticks: tuple[str, int]) -> Availability:
    counter = AvailabilityCounter(TICK_S)
    for state, elapsed in ticks:
        counter.add(state, elapsed)
    return counter.availability(played_ticks=0)


def shares(availability: Availability) -> dict[str, float]:
    return {name: getattr(availability, name) for name in STATE_NAMES}


@given(runs)
def test_the_shares_are_of_the_whole_time_and_add_up_to_it(ticks: list[tuple[str, int]]) -> None:
    found = counted(*ticks)
    assert found.seconds == pytest.approx(TICK_S * sum(elapsed for _, elapsed in ticks))
    assert sum(shares(found).values()) == pytest.approx(1.0)


@given(runs)
def test_what_is_printed_adds_up_to_100(ticks: list[tuple[str, int]]) -> None:
    text = availability_text(dataclasses.asdict(counted(*ticks)))
    assert text is not None
    printed = [float(percent) for percent in re.findall(r"(?<!< )(\d+\.\d) %", text)]
    assert sum(printed) == pytest.approx(100.0)


def test_a_tick_that_was_missed_is_nobodys() -> None:
    found = counted(("playing", 1), ("playing", 3))
    assert (found.felt, found.missed) == (0.5, 0.5)


def test_what_was_not_is_not_printed_and_what_hardly_was_is_not_nothing() -> None:
    ticks = [("playing", 1)] * 9_999 + [("stale", 1)]
    text = availability_text(dataclasses.asdict(counted(*ticks)))
    assert text == "felt 100.0 %, stale < 0.1 % of 10.0 s"


def test_shares_are_unknown_before_the_first_tick() -> None:
    assert counted() == Availability()
    assert availability_text(dataclasses.asdict(Availability())) is None


def interrupted(*ticks: tuple[bool, int]) -> Interruptions:
    counter = InterruptionCounter(1e-3)
    for full, elapsed in ticks:
        counter.add(full, elapsed)
    return counter.interruptions()


def test_interruptions_are_unknown_before_the_first_tick_and_then_none() -> None:
    assert interrupted() == Interruptions()
    assert interrupted((False, 1), (False, 1)) == Interruptions(0, 0.0)
    # A start is none, and neither are missed ticks alone.
    assert interrupted((False, 1), (True, 1), (True, 50), (True, 1)) == Interruptions(0, 0.0)


def test_an_interruption_is_from_one_full_tick_to_the_next() -> None:
    found = interrupted((True, 1), (True, 1), (False, 2600), (False, 1), (True, 1), (True, 1))
    assert dataclasses.astuple(found) == pytest.approx((1, 2.602, 2.602, 0.002, 2.604))


def test_one_that_is_not_over_does_not_count_yet() -> None:
    assert interrupted((True, 1), (False, 500)) == Interruptions(0, 0.0)


def test_several_add_up_and_the_last_has_its_times() -> None:
    found = interrupted((True, 1), (False, 100), (True, 1), (False, 1), (True, 1))
    assert dataclasses.astuple(found) == pytest.approx((2, 0.103, 0.101, 0.102, 0.104))
