import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.counters import LimitCounter, Limited, Limits, limit_texts


@given(st.lists(st.booleans()), st.integers(1, 7))
def test_one_at_a_time_and_in_blocks_count_the_same(limited: list[bool], length: int) -> None:
    single, blocks = LimitCounter(), LimitCounter()
    for tick in limited:
        single.add(tick)
    for first in range(0, len(limited), length):
        blocks.add_all(np.array(limited[first : first + length], bool))
    assert (blocks.ticks, blocks.times) == (single.ticks, single.times)
    assert single.ticks == sum(limited)
    begun = [now and not before for before, now in zip([False, *limited], limited, strict=False)]
    assert single.times == sum(begun)


def test_the_figures_are_times_seconds_and_the_share_of_the_run() -> None:
    counter = LimitCounter()
    for limited in (True, True, False, True):
        counter.add(limited)
    assert counter.limited(1e-3, 12) == Limited(2, pytest.approx(3e-3), 0.25)
    assert LimitCounter().limited(1e-3, 0) == Limited(0, 0.0, 0.0)


def test_each_limit_that_was_reached_is_a_phrase_the_longest_first() -> None:
    limits = Limits(
        force=Limited(1, 0.0041, 0.0001),
        negative=Limited(0, 0.0, 0.0),
        adc=Limited(312, 4.1, 0.205),
    )
    assert limit_texts(dataclasses.asdict(limits)) == [
        "ADC range 312 times, 4.1 s (20.5 % of the run)",
        "force limit 1 time, 4.1 ms (< 0.1 % of the run)",
    ]
    assert limit_texts(dataclasses.asdict(Limits())) == []
    # A recording leaves out the figures that do not apply.
    assert limit_texts({"force": {}}) == limit_texts({}) == []
