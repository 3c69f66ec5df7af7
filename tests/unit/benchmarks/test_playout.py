"""The published rules keep to their definitions, and the optima to what trying all paths finds."""

import math
from collections.abc import Iterable
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.playout import QUICK, RuleOnLink, links, score_rule
from benchmarks.playout.links import best_constant_ms, best_moving, cheapest, in_order
from benchmarks.playout.rules import (
    DelayRule,
    MoonPercentile,
    NetEqLike,
    Ramjee1,
    Ramjee4,
    felt_delays_ns,
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


def test_a_delay_that_grows_for_a_late_frame_does_not_save_what_was_due_already() -> None:
    # The frame sent at 10 ms arrives at 60 with the next eight.
    trace = in_order(np.array([10.0, 10, 50, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10]))
    felt_ns = felt_delays_ns(trace, np.array([12, 12, *[60] * 12]) * MS)
    # By 60 ms all that was sent until 48 had been due.
    assert np.flatnonzero(trace.delay_ns > felt_ns).tolist() == [2, 3, 4, 5, 6, 7, 8, 9]
    assert felt_ns[10:].tolist() == [60 * MS] * 4


def test_a_delay_that_shrinks_plays_what_it_passes_over_at_once() -> None:
    trace = in_order(np.full(8, 10.0))
    # At 20 ms, with the third frame, 40 ms become 11: what was sent until 9 ms is due at once.
    felt_ns = felt_delays_ns(trace, np.array([40, 40, *[11] * 6]) * MS)
    assert (felt_ns / MS).tolist() == [20, 15, 11, 11, 11, 11, 11, 11]


def test_a_share_that_no_setting_reaches_is_not_called_reached() -> None:
    score = score_rule(RuleOnLink("Moon percentile", links.TCP), QUICK, permitted_late=0.0)
    assert not score.reached
    assert score.tuned == min(score.tried, key=lambda played: played.late)


@pytest.fixture(params=range(8))
def delay_ms(request: pytest.FixtureRequest) -> NDArray[np.float64]:
    """Return 12 delays between 20 and 22 ms, with odd seeds at the ends of that."""
    rng = np.random.default_rng(request.param)
    return rng.choice([20.1, 21.9], 12) if request.param % 2 else 20 + 2 * rng.random(12)


@pytest.fixture
def tried(delay_ms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return mean delay and late share, shape (paths, 2), of all paths of levels 0.5 ms apart
    that stay or go to a neighbour every two frames."""
    found = []
    for first, *moves in product(range(5), *[(-1, 0, 1)] * (len(delay_ms) // 2 - 1)):
        positions = first + np.cumsum([0, *moves])
        if positions.min() >= 0 and positions.max() < 5:
            path_ms = np.repeat(20 + 0.5 * positions, 2)
            found.append((path_ms.mean(), (delay_ms > path_ms).mean()))
    return np.array(found)


def test_the_cheapest_path_costs_what_trying_all_finds(
    delay_ms: NDArray[np.float64], tried: NDArray[np.float64]
) -> None:
    for price_ms in (0.0, 0.3, 1.0, 3.0, 10.0, 1000.0):
        found = cheapest(delay_ms, price_ms)
        least_ms = (tried @ [1.0, price_ms]).min()
        assert found.mean_ms + price_ms * found.late == pytest.approx(least_ms)
        assert found.mean_ms == found.path_ms.mean()
        assert found.late == (delay_ms > found.path_ms).mean()


@pytest.mark.parametrize("late", [0.0, 0.1, 0.25])
def test_the_bound_and_the_best_path_enclose_what_trying_all_finds(
    delay_ms: NDArray[np.float64], tried: NDArray[np.float64], late: float
) -> None:
    least_ms = tried[tried[:, 1] <= late, 0].min()
    optimum = best_moving(delay_ms, late)
    assert optimum.best.late <= late
    assert optimum.bound_ms <= least_ms + 1e-9
    assert optimum.best.mean_ms >= least_ms - 1e-9
    if late == 0:
        assert optimum.best.mean_ms == pytest.approx(least_ms)


@pytest.mark.parametrize("late", [0.0, 0.01, 0.1, 0.5])
def test_the_best_constant_has_the_share_late_and_no_smaller_one_has(late: float) -> None:
    delay_ms = np.random.default_rng(2).normal(20, 3, 1000)
    constant_ms = best_constant_ms(delay_ms, late)
    assert (delay_ms > constant_ms).mean() <= late
    assert (delay_ms > constant_ms - 1e-9).mean() > late
