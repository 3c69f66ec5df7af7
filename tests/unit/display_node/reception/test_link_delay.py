import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from display_node.reception.link_delay import BIN_NS, DelayEstimator, LongerPath

MS = 1_000_000
SECOND_NS = 1_000 * MS
FRAME_NS = 5 * MS
FRAMES_A_SECOND = SECOND_NS // FRAME_NS
T0_NS = 1_700_000_000_123_456_789
Draw = Callable[[np.random.Generator, int], NDArray[np.float64]]


def watched(
    estimator: DelayEstimator, delays_ms: Iterable[float], start_s: float = 0
) -> NDArray[np.float64]:
    """Return the estimate in ms after each frame, one every 5 ms from start_s on."""
    estimates_ms = []
    for number, delay_ms in enumerate(delays_ms):
        now_ns = T0_NS + round(start_s * SECOND_NS) + number * FRAME_NS
        estimator.observe(round(delay_ms * MS), now_ns)
        assert estimator.delay_ns is not None
        estimates_ms.append(estimator.delay_ns / MS)
    return np.array(estimates_ms)


def seconds(count: float) -> int:
    return round(count * FRAMES_A_SECOND)


def normal_ms(mean_ms: float, duration_s: float) -> NDArray[np.float64]:
    return np.random.default_rng(1).normal(mean_ms, 1, seconds(duration_s))


def jittered_ms(duration_s: float) -> NDArray[np.float64]:
    return 20 + 2 * np.abs(np.random.default_rng(3).normal(size=seconds(duration_s)))


@pytest.mark.parametrize("late_target", [0.01, 0.05, 0.2])
@pytest.mark.parametrize(
    "draw",
    [lambda rng, n: rng.normal(20, 5, n), lambda rng, n: 20 + rng.exponential(5, n)],
    ids=["gaussian", "exponential"],
)
def test_the_share_of_late_frames_is_near_its_target(draw: Draw, late_target: float) -> None:
    delays_ms = draw(np.random.default_rng(5), seconds(120))
    estimates_ms = watched(DelayEstimator(late_target), delays_ms)
    first = seconds(10)
    # A frame is judged by the estimate before it.
    late = delays_ms[first:] > estimates_ms[first - 1 : -1]
    assert 0.6 * late_target < late.mean() <= late_target
    constant_ms = np.quantile(delays_ms[first:], 1 - late_target)
    assert constant_ms < estimates_ms[first:].mean() < constant_ms + 2
    # The base, the smallest delay of 2 s, varies by a standard deviation.
    assert np.abs(estimates_ms[first:] - constant_ms).max() < 6


@pytest.mark.parametrize("delay_ms", [0.0, 20.3, 1999.9, 9000.0, -30.0])
def test_a_constant_delay_is_covered_by_at_most_a_bin(delay_ms: float) -> None:
    estimates_ms = watched(DelayEstimator(), [delay_ms] * 1000, 12)
    assert len(set(estimates_ms)) == 1
    assert delay_ms < estimates_ms[0] <= delay_ms + BIN_NS / MS


def test_a_longer_path_is_followed_after_50_ms_without_overshoot() -> None:
    estimator = DelayEstimator()
    before_ms = watched(estimator, normal_ms(20, 20))[-1]
    after_ms = watched(estimator, normal_ms(80, 100), 20)
    assert max(after_ms[: seconds(0.05)]) < before_ms + 1
    assert after_ms[seconds(0.06)] == pytest.approx(before_ms + 62, abs=3)
    # The smallest delay of 50 ms is not as small as that of 2 s.
    assert max(after_ms) < before_ms + 64
    assert max(after_ms[seconds(2) :]) < before_ms + 62
    assert min(after_ms[seconds(5) :]) > before_ms + 58


def test_a_shorter_path_is_followed_at_50_ms_a_second() -> None:
    estimator = DelayEstimator()
    watched(estimator, [80.0] * seconds(2))
    after_ms = watched(estimator, [20.0] * seconds(70), 2)
    assert np.diff(after_ms).min() == pytest.approx(-50e-3 * FRAME_NS / MS)
    falling = np.flatnonzero(np.diff(after_ms) < 0)
    took_s = (falling[-1] - falling[0]) * FRAME_NS / SECOND_NS
    assert (after_ms[0], after_ms[-1]) == (80.75, 21.0)
    assert took_s == pytest.approx(60 / 50, rel=0.01)


@pytest.mark.parametrize("silence_s", [3, 30, 3600, 86_400, 10_000_000])
def test_a_silence_does_not_change_the_estimate(silence_s: int) -> None:
    estimator = DelayEstimator()
    watched(estimator, normal_ms(20, 20))
    after_ms = watched(estimator, normal_ms(20, 20), 20 + silence_s)
    assert min(after_ms[seconds(1) :]) > 21
    assert max(after_ms) < 26


@given(st.lists(st.integers(-(2**63), 2**63), min_size=1, max_size=30))
def test_the_estimate_stays_within_its_range(delays_ns: list[int]) -> None:
    estimator = DelayEstimator()
    for number, delay_ns in enumerate(delays_ns):
        estimator.observe(delay_ns, number * SECOND_NS)
        assert estimator.delay_ns is not None
        assert -SECOND_NS <= estimator.delay_ns <= 10 * SECOND_NS


def drain(estimator: DelayEstimator, queued_s: float, start_s: float, within_s: float) -> None:
    """Let a queue of `queued_s` arrive evenly within `within_s`, the oldest frame first."""
    count = seconds(queued_s)
    for number in range(count):
        since_ns = round(within_s * SECOND_NS) * number // count
        sent_ns = number * FRAME_NS - round(queued_s * SECOND_NS)
        now_ns = T0_NS + round(start_s * SECOND_NS) + since_ns
        estimator.observe(since_ns - sent_ns, now_ns)


@pytest.mark.parametrize(
    ("queued_s", "cut_s"), [(0.6, 0.6), (2, 2), (5, 5), (10, 10), (0, 10)], ids=str
)
@pytest.mark.parametrize("within", [0.0001, 0.1, 0.5])
def test_a_cut_does_not_change_the_estimate_however_its_queue_drains(
    queued_s: float, cut_s: float, within: float
) -> None:
    estimator = DelayEstimator()
    before_ms = watched(estimator, jittered_ms(10))[-1]
    drain(estimator, queued_s, 10 + cut_s, queued_s * within)
    after_ms = watched(estimator, jittered_ms(20), 10.01 + cut_s + queued_s * within)
    assert np.abs(after_ms - before_ms).max() <= 3


def test_a_stall_shorter_than_an_outage_raises_the_estimate_for_a_while() -> None:
    estimator = DelayEstimator()
    before_ms = watched(estimator, jittered_ms(10))[-1]
    drain(estimator, 0.3, 10.3, 0.001)
    after_ms = watched(estimator, jittered_ms(30), 10.305)
    # 60 frames are 3 % of 10 s: after another such stall, a third of them would be late.
    assert 100 < after_ms[0] - before_ms < 300
    assert after_ms[-1] - before_ms < 2


def test_a_clock_step_by_an_hour_is_followed_in_both_directions() -> None:
    estimator = DelayEstimator()
    before_ms = watched(estimator, jittered_ms(10))[-1]
    stepped_ms = watched(estimator, jittered_ms(5) + 3_600_000, 10)
    # Its first second could be an outage; delays are clipped to 10 s.
    assert stepped_ms[FRAMES_A_SECOND - 1] == before_ms
    assert set(stepped_ms[2 * FRAMES_A_SECOND :]) == {9999}
    back_ms = watched(estimator, jittered_ms(5), 15)
    assert abs(back_ms[0] - before_ms) < 5
    assert abs(back_ms[-1] - before_ms) < 2
    # They are clipped to −1 s as well.
    assert watched(estimator, jittered_ms(5) - 3_600_000, 20)[-1] < 0
    assert watched(estimator, jittered_ms(5), 25)[-1] == pytest.approx(26, abs=2)


@pytest.mark.parametrize("ppm", [-500, 500])
def test_a_skew_of_500_ppm_is_followed(ppm: float) -> None:
    frames = np.arange(seconds(120))
    skew_ms = frames * (FRAME_NS / MS) * ppm * 1e-6
    over_ms = watched(DelayEstimator(), jittered_ms(120) + skew_ms) - skew_ms
    # 60 ms in all; the base is the smallest delay of 2 s, in which the skew makes 1 ms.
    assert np.abs(over_ms[seconds(5) :] - 26).max() < 2


def test_false_times_of_a_peer_lose_their_weight() -> None:
    estimator = DelayEstimator()
    found_ms = watched(estimator, np.random.default_rng(0).uniform(-2000, 20_000, seconds(10)))
    assert found_ms.min() >= -1000
    assert found_ms.max() <= 10_000
    assert watched(estimator, jittered_ms(60), 10)[-1] == pytest.approx(26, abs=2)


def test_bursts_are_followed_by_a_fast_playout_and_covered_by_a_slow_one() -> None:
    delays_ms = jittered_ms(120)
    # 2 s of every 12 s are 30 ms longer.
    delays_ms += 30 * (np.arange(len(delays_ms)) / FRAMES_A_SECOND % 12 > 10)
    settled = slice(60 * FRAMES_A_SECOND, None)
    late, mean_ms = {}, {}
    for slew in (math.inf, 0.05):
        asked_ms = watched(DelayEstimator(max_slew=slew), delays_ms)[settled]
        # A frame is judged by the estimate before it.
        late[slew] = (delays_ms[settled][1:] > asked_ms[:-1]).mean()
        mean_ms[slew] = asked_ms.mean()
    assert late[0.05] < 0.01
    assert late[math.inf] < 0.02
    assert mean_ms[0.05] > 54
    assert mean_ms[math.inf] < 40


def test_bursts_are_covered_where_following_needs_more_delay() -> None:
    delays_ms = jittered_ms(120)
    at_s = np.arange(len(delays_ms)) / FRAMES_A_SECOND
    delays_ms += 30 * (at_s % 1 > 0.85)
    # The first frames of bursts alone are more than 3 % of all. A tracker that follows requires
    # 30 ms within a burst, and 30 ms more for the first frames of the next one.
    asked_ms = watched(DelayEstimator(late_target=0.03, max_slew=math.inf), delays_ms)
    assert asked_ms[60 * FRAMES_A_SECOND :].mean() == pytest.approx(53, abs=1.5)


def test_delays_older_than_1000_s_have_no_weight() -> None:
    delays_ns = (np.random.default_rng(6).normal(20, 5, 15_000) * MS).astype(int).tolist()
    old, young = DelayEstimator(), DelayEstimator()
    for number, delay_ns in enumerate(delays_ns):
        old.observe(delay_ns, number * SECOND_NS)
        if number >= 2000:
            young.observe(delay_ns, number * SECOND_NS)
        assert number < 3000 or old.delay_ns == young.delay_ns


@pytest.mark.parametrize(
    ("delays_ms", "base_ms"),
    [
        ([60, 62, 64, 66, 68, 70, 72, 74, 76, 78, 80], 60),
        ([60, 59, 58, 57, 56, 55, 54, 53, 52, 51, 51], 51),
        ([80, 69, 60, 60, 60, 60, 60, 60, 60, 60, 60], None),
        ([60, 60, 60, 60, 60, 60, 60, 60, 60, 40, 60], None),
    ],
    ids=["rising", "falling little", "fell", "not lasting"],
)
def test_a_longer_path_lasts_and_does_not_fall(delays_ms: list[int], base_ms: int | None) -> None:
    longer = LongerPath(50 * MS)
    found = [
        longer.base_ns(delay_ms * MS, 50 * MS, T0_NS + number * FRAME_NS)
        for number, delay_ms in enumerate(delays_ms)
    ]
    assert found == [*[None] * 10, None if base_ms is None else base_ms * MS]
