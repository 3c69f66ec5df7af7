import dataclasses
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.availability import NAMES, Availability, AvailabilityCounter, availability_text

TICK_S = 1e-3
STATES = ["playing", "starting", "stale", "fault", "waiting", "ended"]
runs = st.lists(st.tuples(st.sampled_from(STATES), st.integers(1, 50)), min_size=1, max_size=300)


def counted(*ticks: tuple[str, int]) -> Availability:
    counter = AvailabilityCounter(TICK_S)
    for state, elapsed in ticks:
        counter.add(state, elapsed)
    return counter.availability(played_ticks=0)


def shares(availability: Availability) -> dict[str, float]:
    return {name: getattr(availability, name) for name in NAMES}


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


def test_before_the_first_tick_nothing_is_known() -> None:
    assert counted() == Availability()
    assert availability_text(dataclasses.asdict(Availability())) is None
