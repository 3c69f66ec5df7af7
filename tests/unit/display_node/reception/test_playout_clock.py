import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.reception.playout_clock import PlayoutClock

MS = 1_000_000
T0_NS = 1_700_000_000_123_456_789


@given(st.lists(st.tuples(st.integers(0, 100 * MS), st.integers(-240 * MS, 240 * MS)), min_size=2))
def test_playout_is_slewed_by_at_most_5_percent_and_never_goes_back(
    steps: list[tuple[int, int]],
) -> None:
    clock = PlayoutClock()
    now_ns = instant_ns = clock.instant(T0_NS, T0_NS)
    for elapsed_ns, offset_ns in steps:
        now_ns += elapsed_ns
        last_ns, instant_ns = instant_ns, clock.instant(now_ns, now_ns + offset_ns)
        assert abs(instant_ns - last_ns - elapsed_ns) <= 0.05 * elapsed_ns
        assert instant_ns >= last_ns


@pytest.mark.parametrize("offset_ms", [-60, -0.01, 0, 0.01, 60, 450])
def test_playout_reaches_the_wanted_instant_and_stays_there(offset_ms: float) -> None:
    clock = PlayoutClock()
    clock.instant(T0_NS, T0_NS)
    offset_ns = round(offset_ms * MS)
    needed = math.ceil(abs(offset_ns) / (MS // 20)) + 1
    for tick in range(1, needed + 50):
        now_ns = T0_NS + tick * MS
        instant_ns = clock.instant(now_ns, now_ns + offset_ns)
        assert tick < needed or instant_ns == now_ns + offset_ns


def test_playout_follows_a_clock_1_percent_fast_and_a_stall_is_no_jump() -> None:
    clock = PlayoutClock()
    for tick in (*range(10_000), 15_000):
        assert clock.instant(tick * MS, tick * (MS + MS // 100)) == tick * (MS + MS // 100)


@pytest.mark.parametrize("offset_ms", [499, -499, 501, -501, 3_600_000])
def test_playout_jumps_over_a_difference_above_half_a_second(offset_ms: int) -> None:
    clock = PlayoutClock()
    clock.instant(0, 0)
    for now_ns in (MS, 2 * MS):
        wanted_ns = now_ns + offset_ms * MS
        assert (clock.instant(now_ns, wanted_ns) == wanted_ns) == (abs(offset_ms) > 500)
