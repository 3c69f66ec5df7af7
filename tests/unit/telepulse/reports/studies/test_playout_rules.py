import math
from collections.abc import Iterable

import numpy as np
import pytest

from telepulse.reports.studies.playout_links import DelayTrace, in_order
from telepulse.reports.studies.playout_rules import (
    DelayRule,
    FixedDelay,
    MoonPercentile,
    NetEqLike,
    Ramjee1,
    Ramjee4,
    felt_delays_ns,
    play,
)

MS = 1_000_000


def set_ms(rule: DelayRule, delays_ms: Iterable[float], start_ms: int = 0) -> list[float]:
    """The delay in ms after each frame, one every 5 ms."""
    delays = []
    for number, delay_ms in enumerate(delays_ms):
        rule.observe(round(delay_ms * MS), round((start_ms + 5 * number + delay_ms) * MS))
        delays.append((rule.delay_ns or 0) / MS)
    return delays


def gaussian(mean_ms: float = 20, count: int = 20_000) -> Iterable[float]:
    delays: list[float] = np.random.default_rng(1).normal(mean_ms, 3, count).tolist()
    return delays


@pytest.mark.parametrize("make", [Ramjee1, Ramjee4])
def test_ramjees_ask_for_mean_and_beta_mean_deviations(make: type[Ramjee1 | Ramjee4]) -> None:
    for beta in (0.0, 4.0):
        settled_ms = np.mean(set_ms(make(beta), gaussian())[5000:])
        # A Gaussian's mean deviation is √(2/π) of its standard deviation; a mean that follows
        # each delay by 1 − α is nearer to it.
        alpha = make.ALPHA
        near = alpha * math.sqrt(1 + (1 - alpha) / (1 + alpha))
        expected_ms = 20 + beta * 3 * math.sqrt(2 / math.pi) * near
        assert settled_ms == pytest.approx(expected_ms, abs=0.1)


def test_ramjee_1_takes_seconds_to_follow_and_4_takes_frames() -> None:
    for rule, frames in ((Ramjee1(0), 347), (Ramjee4(0), 6)):
        set_ms(rule, [20.0] * 100)
        after_ms = set_ms(rule, [60.0] * 1000, 500)
        # Half of the way: (ln 2) / (1 − α) frames.
        assert next(i for i, ms in enumerate(after_ms) if ms > 40) == pytest.approx(frames, abs=2)


def test_ramjee_4_follows_a_spike_and_leaves_it() -> None:
    rule = Ramjee4(0)
    set_ms(rule, [20.0] * 200)
    spike_ms = [170.0 - 5 * number for number in range(30)]
    during_ms = set_ms(rule, spike_ms, 1000)
    assert during_ms[0] == 170
    assert during_ms[3] == pytest.approx(155, abs=20)
    assert set_ms(rule, [20.0] * 100, 1200)[-1] == pytest.approx(20, abs=0.1)


def test_moon_sets_the_percentile_of_the_last_10_000() -> None:
    delays_ms = list(gaussian())
    rule = MoonPercentile(0.01)
    assert set_ms(rule, delays_ms)[-1] == pytest.approx(
        np.quantile(delays_ms[-10_000:], 0.99), abs=0.02
    )
    # Half of the window is enough to see nothing else.
    assert set_ms(rule, [50.0] * 5000, 100_000)[-1] == 50


def test_moon_plays_a_spike_with_each_of_its_delays_and_does_not_count_them() -> None:
    rule = MoonPercentile(0.01)
    before_ms = set_ms(rule, gaussian())[-1]
    spike_ms = [300.0, 200.0, 100.0]
    assert set_ms(rule, spike_ms, 100_000) == spike_ms
    assert set_ms(rule, gaussian(count=300), 100_100)[-1] == pytest.approx(before_ms, abs=0.5)


def test_neteq_sets_whole_buckets_over_the_smallest() -> None:
    rule = NetEqLike(0.05)
    assert set_ms(rule, [20.0] * 50)[-1] == 20 + 80
    assert set_ms(rule, [20.0] * 2000, 250)[-1] == 20 + 20
    # Of every 500 ms, the largest counts: one of 100 frames is enough.
    spiky_ms = [65.0 if number % 100 == 50 else 20.0 for number in range(20_000)]
    assert set_ms(NetEqLike(0.05), spiky_ms)[-1] == 20 + 60


def test_neteq_follows_a_longer_path_after_2_s_and_a_shorter_one_at_once() -> None:
    rule = NetEqLike(0.05)
    set_ms(rule, [20.0] * 2000)
    longer_ms = set_ms(rule, [50.0] * 500, 10_000)
    assert longer_ms[380] < 90
    assert longer_ms[420] >= 70
    assert set_ms(rule, [30.0] * 2, 12_500)[-1] - longer_ms[-1] == -20


def test_a_fixed_delay_is_the_first_and_a_reserve() -> None:
    assert set_ms(FixedDelay(7 * MS), [20.0, 90.0, 5.0]) == [27.0] * 3


class Scripted:
    """A rule that sets the next of a row of delays after every frame."""

    def __init__(self, *delays_ms: float) -> None:
        self._delays_ms = list(delays_ms)
        self.delay_ns: int | None = None

    def observe(self, delay_ns: int, now_ns: int) -> None:
        self.delay_ns = round(self._delays_ms.pop(0) * MS)


def felt_ms(trace: DelayTrace, *set_ms: float) -> list[float]:
    set_ns = np.array([round(ms * MS) for ms in set_ms])
    felt: list[float] = (felt_delays_ns(trace, set_ns) / MS).tolist()
    return felt


def test_a_constant_delay_is_felt_and_what_is_above_it_is_late() -> None:
    delays_ms = np.random.default_rng(1).normal(20, 3, 2000)
    trace = in_order(delays_ms)
    played = play(FixedDelay(round(7 * MS)), trace)
    used_ns = trace.delay_ns[0] + 7 * MS
    assert played.delay_ms == pytest.approx(used_ns / MS)
    assert played.late == (trace.delay_ns > used_ns).mean()
    assert 0 < played.late < 0.2


def test_a_delay_that_grows_for_a_late_frame_does_not_save_what_was_due_already() -> None:
    # The frame sent at 10 ms arrives at 60 with the next eight.
    trace = in_order(np.array([10.0, 10, 50, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10]))
    set_ms = [12.0, 12, *[60.0] * 12]
    felt = np.array(felt_ms(trace, *set_ms))
    late = trace.delay_ns / MS > felt
    # By 60 ms all that was sent until 48 had been due.
    assert np.flatnonzero(late).tolist() == [2, 3, 4, 5, 6, 7, 8, 9]
    assert felt[10:].tolist() == [60.0] * 4


def test_a_delay_that_shrinks_plays_what_it_passes_over_at_once() -> None:
    trace = in_order(np.full(8, 10.0))
    # At 20 ms, with the third frame, 40 ms become 11: what was sent until 9 ms is due at once.
    felt = felt_ms(trace, 40, 40, 11, 11, 11, 11, 11, 11)
    assert felt == [20, 15, 11, 11, 11, 11, 11, 11]


def test_a_warped_playout_goes_up_by_50_ms_a_second() -> None:
    frames = 800
    trace = in_order(np.full(frames, 10.0))
    at_once = play(Scripted(10, *[50.0] * (frames - 1)), trace)
    warped = play(Scripted(10, *[50.0] * (frames - 1)), trace, warped=True)
    assert at_once.delay_ms == pytest.approx(50, abs=0.2)
    # 40 ms take 0.8 s of the 4, in which 95 % of 160 frames are played, 20 ms off on average; the
    # first is played before any of it.
    assert warped.delay_ms == pytest.approx(50 - 40 * (1 + 0.95 * 160 / 2) / frames, abs=0.01)
    assert warped.late == 0
