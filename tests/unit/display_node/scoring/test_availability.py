import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.scoring.availability import AvailabilityCounter, InterruptionCounter
from protocol.summary import fields, phrases
from protocol.ticks import DISPLAY_STATES

TICK_S = 1e-3
STATES = list(DISPLAY_STATES)
runs = st.lists(st.tuples(st.sampled_from(STATES), st.integers(1, 50)), min_size=1, max_size=300)


def counted(*ticks: tuple[str, int]) -> fields.Availability:
    counter = AvailabilityCounter(TICK_S)
    numbers = [DISPLAY_STATES.index(state) for state, _ in ticks]
    counter.add(np.array(numbers), np.array([elapsed for _, elapsed in ticks]))
    return counter.availability(played_ticks=0)


@given(runs)
def test_the_shares_are_of_the_whole_time_and_add_up_to_it(ticks: list[tuple[str, int]]) -> None:
    found = counted(*ticks)
    assert found.seconds == pytest.approx(TICK_S * sum(elapsed for _, elapsed in ticks))
    assert sum(getattr(found, name) for name in fields.STATES) == pytest.approx(1.0)
    text = phrases.availability_text(dataclasses.asdict(found))
    assert text is not None
    printed = [float(percent) for percent in re.findall(r"(?<!< )(\d+\.\d) %", text)]
    assert sum(printed) == pytest.approx(100.0)


def interrupted(*ticks: tuple[bool, int], blocks: int = 1) -> fields.Interruptions:
    counter = InterruptionCounter(1e-3)
    for block in np.array_split(np.array(ticks, int).reshape(-1, 2), blocks):
        if len(block):
            counter.add(*block.T)
    return counter.interruptions()


def test_interruptions_are_unknown_before_the_first_tick_and_then_0() -> None:
    none = fields.Interruptions(0, 0.0)
    assert interrupted() == fields.Interruptions()
    assert interrupted((False, 1), (False, 1)) == none
    # Neither a start nor missed ticks alone are an interruption.
    assert interrupted((False, 1), (True, 1), (True, 50), (True, 1)) == none
    # One that has not ended does not count.
    assert interrupted((True, 1), (False, 500)) == none


def test_an_interruption_is_from_one_full_tick_to_the_next_and_several_add_up() -> None:
    found = interrupted((True, 1), (True, 1), (False, 2600), (False, 1), (True, 1), (True, 1))
    assert dataclasses.astuple(found) == pytest.approx((1, 2.602, 2.602, 0.002, 2.604))
    found = interrupted((True, 1), (False, 100), (True, 1), (False, 1), (True, 1))
    assert dataclasses.astuple(found) == pytest.approx((2, 0.103, 0.101, 0.102, 0.104))


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 9))), st.integers(2, 30))
def test_interruptions_do_not_depend_on_where_blocks_end(
    ticks: list[tuple[bool, int]], blocks: int
) -> None:
    assert interrupted(*ticks, blocks=blocks) == interrupted(*ticks)
