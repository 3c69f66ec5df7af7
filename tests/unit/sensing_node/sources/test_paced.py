import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from protocol.wire.stream import Channel
from sensing_node.sources import PacedSource, SampleBlock

PERIOD_NS = 1_000_000
START_NS = 77_000_000_123


class Counting:
    """Sample number i has the value i; there are `length` of them."""

    channels = (Channel("pulse"),)
    period_ns = PERIOD_NS

    def __init__(self, length: int) -> None:
        self._left = np.arange(length, dtype=np.float64)[:, np.newaxis]

    def take(self, count: int) -> NDArray[np.float64]:
        taken, self._left = self._left[:count], self._left[count:]
        return taken


def paced(length: int = 1000) -> PacedSource:
    return PacedSource(Counting(length), START_NS)


def numbers(block: SampleBlock | None) -> list[int]:
    return [] if block is None else block.values[:, 0].astype(int).tolist()


@pytest.mark.parametrize(
    ("after_ns", "count"),
    [
        (-PERIOD_NS, 0),
        (-1, 0),
        (0, 1),
        (PERIOD_NS - 1, 1),
        (PERIOD_NS, 2),
        (9 * PERIOD_NS, 10),
        (100 * PERIOD_NS - 1, 100),
    ],
)
def test_samples_fall_due_one_a_period_from_the_start_on(after_ns: int, count: int) -> None:
    assert numbers(paced().read(START_NS + after_ns)) == list(range(count))


def test_nothing_is_given_twice() -> None:
    source = paced()
    assert numbers(source.read(START_NS + 4 * PERIOD_NS)) == [0, 1, 2, 3, 4]
    assert source.read(START_NS + 4 * PERIOD_NS) is None
    assert source.read(START_NS + 2 * PERIOD_NS) is None
    assert numbers(source.read(START_NS + 6 * PERIOD_NS)) == [5, 6]


@given(st.lists(st.integers(-PERIOD_NS, 20 * PERIOD_NS), max_size=20))
def test_however_it_is_read_every_sample_comes_once_at_its_time(after_ns: list[int]) -> None:
    source, seen = paced(), 0
    for after in sorted(after_ns):
        block = source.read(START_NS + after)
        assert numbers(block) == list(range(seen, max(seen, after // PERIOD_NS + 1)))
        if block is not None:
            assert block.t_first_ns == START_NS + seen * PERIOD_NS
            assert block.period_ns == PERIOD_NS
            seen += len(block.values)


def test_what_is_due_next_is_told_ahead() -> None:
    source = paced()
    assert source.due_ns(1) == START_NS
    assert source.due_ns(5) == START_NS + 4 * PERIOD_NS
    source.read(START_NS + 2 * PERIOD_NS)
    assert source.due_ns(1) == START_NS + 3 * PERIOD_NS
    assert numbers(source.read(source.due_ns(5))) == [3, 4, 5, 6, 7]


def test_a_source_that_ends_gives_its_rest_and_is_exhausted() -> None:
    source = paced(length=7)
    assert len(numbers(source.read(source.due_ns(5)))) == 5
    assert not source.exhausted
    assert numbers(source.read(source.due_ns(5))) == [5, 6]
    assert source.exhausted
    assert source.read(START_NS + 1000 * PERIOD_NS) is None


def test_a_source_that_ends_with_a_full_read_is_exhausted_at_the_next() -> None:
    source = paced(length=5)
    assert len(numbers(source.read(source.due_ns(5)))) == 5
    assert source.read(source.due_ns(5)) is None
    assert source.exhausted
