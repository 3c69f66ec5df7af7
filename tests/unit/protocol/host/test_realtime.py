import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import RealtimeError
from protocol.host.realtime import Pacer, RealtimeRequest, parse_realtime
from tests.support.refusals import refusal_of

MS = 1_000_000


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, RealtimeRequest()),
        ("fifo", RealtimeRequest(fifo=40)),
        ("lock", RealtimeRequest(lock=True)),
        ("cpu=0", RealtimeRequest(cpus=frozenset({0}))),
        ("cpu=2-4", RealtimeRequest(cpus=frozenset({2, 3, 4}))),
        ("cpu=1,cpu=3", RealtimeRequest(cpus=frozenset({1, 3}))),
        (" lock , slack ", RealtimeRequest(lock=True, slack=True)),
        (
            "fifo=20,lock,cpu=1,slack,strict",
            RealtimeRequest(20, lock=True, cpus=frozenset({1}), slack=True, strict=True),
        ),
    ],
)
def test_a_realtime_option_is_parsed(text: str | None, expected: RealtimeRequest) -> None:
    assert parse_realtime(text) == expected


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "unknown measure ''; known: fifo, lock, cpu, slack, strict"),
        ("lok", "unknown measure 'lok'; did you mean lock?"),
        ("fifo=0", "fifo=0: a priority is 1 to 98"),
        ("fifo=99", "fifo=99: a priority is 1 to 98"),
        ("fifo=²", "fifo=²: a priority"),
        ("fifo,fifo=3", "fifo is there twice"),
        ("lock=yes", "lock takes no value, got 'yes'"),
        ("cpu", "cpu=: write one as cpu=1"),
        ("cpu=3-1", "cpu=3-1: write one"),
        ("cpu=1-99999", "cpu=1-99999: write one"),
    ],
)
def test_an_invalid_realtime_option_is_refused_in_one_line(text: str, reason: str) -> None:
    assert refusal_of(RealtimeError, parse_realtime, text).startswith(f"--realtime: {reason}")


@given(st.integers(1, 10 * MS), st.integers(-(1 << 60), 1 << 60), st.lists(st.integers(0, 50 * MS)))
def test_every_period_is_counted_once(tick_ns: int, begin_ns: int, waits_ns: list[int]) -> None:
    pacer, now_ns, ticks = Pacer(tick_ns, begin_ns), begin_ns, 0
    for wait_ns in waits_ns:
        now_ns, due_ns, missed = now_ns + wait_ns, pacer.due_ns, pacer.missed
        tick = pacer.begin(now_ns)
        assert (tick is None) == (now_ns < due_ns)
        if tick is not None:
            ticks += 1
            assert (tick.late_ns, tick.elapsed_ticks) == (
                now_ns - due_ns,
                1 + pacer.missed - missed,
            )
            assert tick.due_ns <= now_ns < tick.due_ns + tick_ns == pacer.due_ns
    assert ticks + pacer.missed == (now_ns - begin_ns) // tick_ns
