import math
from collections.abc import Iterable

import numpy as np
import pytest

from telepulse.reports.studies.playout_rules import (
    DelayRule,
    FixedDelay,
    MoonPercentile,
    NetEqLike,
    Ramjee1,
    Ramjee4,
)

MS = 1_000_000


def asked_ms(rule: DelayRule, delays_ms: Iterable[float], start_ms: int = 0) -> list[float]:
    """The delay in ms after each frame, one every 5 ms."""
    asked = []
    for number, delay_ms in enumerate(delays_ms):
        rule.observe(round(delay_ms * MS), round((start_ms + 5 * number + delay_ms) * MS))
        asked.append((rule.delay_ns or 0) / MS)
    return asked


def gaussian(mean_ms: float = 20, count: int = 20_000) -> Iterable[float]:
    delays: list[float] = np.random.default_rng(1).normal(mean_ms, 3, count).tolist()
    return delays


@pytest.mark.parametrize("make", [Ramjee1, Ramjee4])
def test_ramjees_ask_for_mean_and_beta_mean_deviations(make: type[Ramjee1 | Ramjee4]) -> None:
    for beta in (0.0, 4.0):
        settled_ms = np.mean(asked_ms(make(beta), gaussian())[5000:])
        # A Gaussian's mean deviation is √(2/π) of its standard deviation; a mean that follows
        # each delay by 1 − α is nearer to it.
        alpha = make.ALPHA
        near = alpha * math.sqrt(1 + (1 - alpha) / (1 + alpha))
        expected_ms = 20 + beta * 3 * math.sqrt(2 / math.pi) * near
        assert settled_ms == pytest.approx(expected_ms, abs=0.1)


def test_ramjee_1_takes_seconds_to_follow_and_4_takes_frames() -> None:
    for rule, frames in ((Ramjee1(0), 347), (Ramjee4(0), 6)):
        asked_ms(rule, [20.0] * 100)
        after_ms = asked_ms(rule, [60.0] * 1000, 500)
        # Half of the way: (ln 2) / (1 − α) frames.
        assert next(i for i, ms in enumerate(after_ms) if ms > 40) == pytest.approx(frames, abs=2)


def test_ramjee_4_follows_a_spike_and_leaves_it() -> None:
    rule = Ramjee4(0)
    asked_ms(rule, [20.0] * 200)
    spike_ms = [170.0 - 5 * number for number in range(30)]
    during_ms = asked_ms(rule, spike_ms, 1000)
    assert during_ms[0] == 170
    assert during_ms[3] == pytest.approx(155, abs=20)
    assert asked_ms(rule, [20.0] * 100, 1200)[-1] == pytest.approx(20, abs=0.1)


def test_moon_asks_for_the_percentile_of_the_last_10_000() -> None:
    delays_ms = list(gaussian())
    rule = MoonPercentile(0.01)
    assert asked_ms(rule, delays_ms)[-1] == pytest.approx(
        np.quantile(delays_ms[-10_000:], 0.99), abs=0.02
    )
    # Half of the window is enough to see nothing else.
    assert asked_ms(rule, [50.0] * 5000, 100_000)[-1] == 50


def test_moon_plays_a_spike_with_each_of_its_delays_and_does_not_count_them() -> None:
    rule = MoonPercentile(0.01)
    before_ms = asked_ms(rule, gaussian())[-1]
    spike_ms = [300.0, 200.0, 100.0]
    assert asked_ms(rule, spike_ms, 100_000) == spike_ms
    assert asked_ms(rule, gaussian(count=300), 100_100)[-1] == pytest.approx(before_ms, abs=0.5)


def test_neteq_asks_for_whole_buckets_over_the_smallest() -> None:
    rule = NetEqLike(0.05)
    assert asked_ms(rule, [20.0] * 50)[-1] == 20 + 80
    assert asked_ms(rule, [20.0] * 2000, 250)[-1] == 20 + 20
    # Of every 500 ms, the largest counts: one of 100 frames is enough.
    spiky_ms = [65.0 if number % 100 == 50 else 20.0 for number in range(20_000)]
    assert asked_ms(NetEqLike(0.05), spiky_ms)[-1] == 20 + 60


def test_neteq_follows_a_longer_path_after_2_s_and_a_shorter_one_at_once() -> None:
    rule = NetEqLike(0.05)
    asked_ms(rule, [20.0] * 2000)
    longer_ms = asked_ms(rule, [50.0] * 500, 10_000)
    assert longer_ms[380] < 90
    assert longer_ms[420] >= 70
    assert asked_ms(rule, [30.0] * 2, 12_500)[-1] - longer_ms[-1] == -20


def test_a_fixed_delay_is_the_first_and_a_reserve() -> None:
    assert asked_ms(FixedDelay(7 * MS), [20.0, 90.0, 5.0]) == [27.0] * 3
