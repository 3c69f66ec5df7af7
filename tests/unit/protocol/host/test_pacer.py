from hypothesis import given
from hypothesis import strategies as st

from protocol.host.pacer import PacedTick, Pacer

MS = 1_000_000


def test_late_ticks_stay_on_the_grid_and_stand_for_those_they_missed() -> None:
    pacer = Pacer(MS, 0)
    assert pacer.begin(MS - 1) is None
    assert pacer.begin(MS) == PacedTick(MS, 0, 1)
    assert pacer.begin(MS + 1) is None
    assert pacer.begin(4 * MS + 400_000) == PacedTick(4 * MS, 2_400_000, 3)
    assert (pacer.due_ns, pacer.missed) == (5 * MS, 2)


@given(st.integers(1, 10 * MS), st.integers(-(1 << 60), 1 << 60), st.lists(st.integers(0, 50 * MS)))
def test_every_period_is_counted_once(tick_ns: int, begin_ns: int, waits_ns: list[int]) -> None:
    pacer, now_ns, ticks = Pacer(tick_ns, begin_ns), begin_ns, 0
    for wait_ns in waits_ns:
        now_ns += wait_ns
        tick = pacer.begin(now_ns)
        if tick is not None:
            ticks += 1
            assert tick.due_ns <= now_ns < tick.due_ns + tick_ns == pacer.due_ns
    assert ticks + pacer.missed == (now_ns - begin_ns) // tick_ns
