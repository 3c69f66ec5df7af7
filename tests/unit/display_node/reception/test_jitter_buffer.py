import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.reception.jitter_buffer import (
    KEEP_SAMPLES,
    MAX_AHEAD_SAMPLES,
    TIME_TOLERANCE_NS,
    JitterBuffer,
)
from protocol.wire.messages import Frame
from tests.support.frames import MS, T0_NS, at_ns, filled, frame, refusal


def test_a_duplicate_is_refused_and_changes_nothing() -> None:
    buffer = filled(frame(0), frame(5))
    buffer.advance(at_ns(2))
    before = (buffer.account(), buffer.waiting, buffer.frames, buffer.known(MS, 20))
    altered = frame(5)._replace(values=np.full((5, 1), 99.0))
    assert [refusal(buffer, again) for again in (frame(0), altered)] == ["duplicate"] * 2
    assert (buffer.account(), buffer.waiting, buffer.frames, buffer.known(MS, 20)) == before


@pytest.mark.parametrize(
    ("first", "count", "cause"),
    [
        (3, 4, "overlap"),
        (5, 6, "overlap"),
        (9, 2, "overlap"),
        (10, 30, "overlap"),
        (22, 5, "overlap"),
        (11, 3, "duplicate"),
        (24, 1, "duplicate"),
    ],
)
def test_a_frame_that_overlaps_is_refused(first: int, count: int, cause: str) -> None:
    buffer = filled(frame(0), frame(10), frame(20))
    assert refusal(buffer, frame(first, count)) == cause
    assert buffer.frames == 3


@pytest.mark.parametrize(
    ("first", "shift_ns"),
    [
        (200, -100 * MS),
        (200, TIME_TOLERANCE_NS + 20 * MS),
        (50, 50 * MS),
        (50, -TIME_TOLERANCE_NS - 20 * MS),
        (50, 60 * MS),
        (102, 2 * MS),
        (102, -2 * MS),
    ],
)
def test_a_time_that_does_not_fit_the_neighbours_is_refused(first: int, shift_ns: int) -> None:
    buffer = filled(frame(100, 1), frame(104, 1))
    assert refusal(buffer, frame(first, 1, shift_ns)) == "timestamp"
    assert buffer.frames == 2


@pytest.mark.parametrize("shift_ns", [-TIME_TOLERANCE_NS // 2, TIME_TOLERANCE_NS])
def test_a_clock_that_wanders_is_taken(shift_ns: int) -> None:
    assert filled(frame(0), frame(1000, shift_ns=shift_ns)).frames == 2


def test_frames_a_hundred_places_out_of_order_are_put_right() -> None:
    frames = [frame(5 * number) for number in range(101)]
    buffer = filled(*reversed(frames))
    assert (buffer.frames, buffer.reordered) == (101, 100)
    buffer.advance(at_ns(0))
    assert buffer.known(MS, 505) == [0.5 * sample for sample in range(505)]


def test_memory_does_not_grow_with_the_stream() -> None:
    buffer = JitterBuffer(0)
    tracemalloc.start()
    try:
        for number in range(40):
            buffer.put(frame(3000 * number, 3000))
            buffer.advance(at_ns(3000 * number))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 150 * 2 * KEEP_SAMPLES


@pytest.mark.parametrize("order", [1, -1])
def test_samples_that_wait_are_limited(order: int) -> None:
    buffer = JitterBuffer(0)
    firsts = range(0, 2 * MAX_AHEAD_SAMPLES, 4096)[::order]
    for first in firsts[: MAX_AHEAD_SAMPLES // 4096]:
        buffer.put(frame(first, 4096))
    assert refusal(buffer, frame(firsts[MAX_AHEAD_SAMPLES // 4096], 4096)) == "overflow"
    assert buffer.waiting == MAX_AHEAD_SAMPLES


def test_samples_that_were_played_do_not_count_against_that_limit() -> None:
    buffer = filled(*(frame(first, 4000) for first in range(0, 32_000, 4000)))
    buffer.advance(at_ns(31_999))
    for first in range(32_000, 32_000 + MAX_AHEAD_SAMPLES - 4000, 4000):
        buffer.put(frame(first, 4000))
    assert buffer.waiting == 64_000


def test_the_instant_is_known_with_many_samples_waiting() -> None:
    buffer = filled(*(frame(first, 1000) for first in range(0, 2 * KEEP_SAMPLES - 1000, 1000)))
    for first in range(32_000, 36_000, 1000):
        buffer.advance(at_ns(10_000.5))
        buffer.put(frame(first, 1000))
        assert buffer.known(MS, 2) == [5000.25, 5000.75]


@settings(deadline=None)
@given(
    st.lists(st.booleans(), min_size=1, max_size=8),
    st.floats(0, 40),
    st.integers(1, 3 * MS),
    st.integers(1, 30),
)
def test_a_straight_line_is_exact_even_across_missing_frames(
    missing: list[bool], start: float, step_ns: int, count: int
) -> None:
    here = [number for number, gone in enumerate([False, *missing, False]) if not gone]
    buffer = filled(*(frame(5 * number) for number in here))
    newest_ns, instant_ns = at_ns(5 * here[-1] + 4), at_ns(start)
    buffer.advance(instant_ns)
    instants = [instant_ns + i * step_ns for i in range(count)]
    expected = [0.5 * (t_ns - T0_NS) / MS for t_ns in instants if t_ns <= newest_ns]
    assert buffer.known(step_ns, count) == pytest.approx(expected, abs=1e-12)
    assert buffer.newest_ns == newest_ns


def test_nothing_is_known_before_the_first_sample() -> None:
    buffer = JitterBuffer(0)
    assert (buffer.known(MS, 2), buffer.newest_ns) == ([], None)
    buffer.put(frame(10))
    assert buffer.known(MS, 2) == []
    buffer.advance(at_ns(9.9))
    assert buffer.known(MS, 2) == []
    buffer.advance(at_ns(10))
    assert buffer.known(MS, 2) == [5.0, 5.5]


@pytest.mark.parametrize("order", [1, -1], ids=["in order", "out of order"])
@pytest.mark.parametrize("channel", [0, 1, 2])
def test_one_channel_is_played(channel: int, order: int) -> None:
    buffer = JitterBuffer(channel)
    values = np.array([[1, 10, 100], [2, 20, 200], [3, 30, 300], [4, 40, 400]], dtype="<f4")
    frames = [Frame(1, n, at_ns(n), MS, values[n : n + 2]) for n in (0, 2)]
    for each in frames[::order]:
        buffer.put(each)
    buffer.advance(at_ns(0))
    assert buffer.known(MS, 4) == [n * 10.0**channel for n in (1, 2, 3, 4)]


def test_frames_of_one_sample_are_played() -> None:
    buffer = filled(*(frame(number, 1) for number in (0, 2, 1, 4)))
    buffer.advance(at_ns(1))
    assert buffer.known(MS, 5) == [0.5, 1.0, 1.5, 2.0]
    buffer.advance(at_ns(4))
    account = buffer.account()
    assert (account.sent, account.played, account.lost) == (5, 4, 1)
