import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.summary.fields import Limited
from protocol.ticks import LimitCounter


@given(st.lists(st.booleans()), st.integers(1, 7))
def test_single_ticks_and_blocks_give_the_same_counts(limited: list[bool], length: int) -> None:
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
