from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from telepulse.reports.studies.playout_links import (
    BURSTS,
    FAST,
    FRAME_MS,
    FRAME_NS,
    GAUSSIAN,
    LINKS,
    RANDOM,
    ROUTE,
    SLOW,
    SPIKES,
    TCP,
    DelayTrace,
    best_constant_ms,
    best_moving,
    cheapest,
    in_order,
    make_trace,
)

MS = 1e6


def delays_ms(name: str, seconds: float = 120) -> np.ndarray:
    return make_trace(name, seconds).delay_ns / MS


@pytest.mark.parametrize("name", LINKS)
def test_a_trace_can_be_made_again_and_no_frame_overtakes_another(name: str) -> None:
    trace = make_trace(name, 60)
    assert len(trace.sent_ns) == 12_000
    assert set(np.diff(trace.sent_ns)) == {FRAME_NS}
    assert trace.delay_ns.min() > 0
    assert np.diff(trace.arrived_ns).min() >= 0
    assert (make_trace(name, 5).delay_ns == make_trace(name, 5).delay_ns).all()


def test_a_frame_that_waits_for_another_arrives_with_it() -> None:
    trace: DelayTrace = in_order(np.array([20.0, 40.0, 20.0, 20.0, 20.0, 20.0]))
    assert (trace.delay_ns / MS).tolist() == [20, 40, 35, 30, 25, 20]


def test_the_quiet_path_is_20_ms_with_a_deviation_of_3() -> None:
    # One in nine waits for a slower one before it: later than drawn, and nearer to the others.
    delay_ms = delays_ms(GAUSSIAN)
    assert delay_ms.mean() == pytest.approx(20.2, abs=0.2)
    assert delay_ms.std() == pytest.approx(2.77, abs=0.05)


def test_a_spike_of_100_ms_holds_up_100_ms_of_frames_every_20_s() -> None:
    held = delays_ms(SPIKES) > 40
    starts = np.flatnonzero(np.diff(held.astype(int)) == 1) + 1
    assert np.diff(starts).tolist() == [4000] * 5
    # Less the jitter of the first and last.
    assert held.sum() == pytest.approx(6 * (100 - 20) / 5, abs=10)


@pytest.mark.parametrize(
    ("name", "more_ms", "within_ms"),
    [(ROUTE, 60, 0.2), (FAST, 0.2 * 60, 0.12), (SLOW, -0.2 * 60, 0.12)],
)
def test_a_route_or_a_drift_of_200_us_a_second_delays_the_second_minute(
    name: str, more_ms: float, within_ms: float
) -> None:
    before_ms, after_ms = np.split(delays_ms(name), 2)
    assert after_ms.mean() - before_ms.mean() == pytest.approx(more_ms, abs=within_ms)


def test_bursts_are_there_a_sixth_of_the_time() -> None:
    assert (delays_ms(BURSTS, 3000) > 36).mean() == pytest.approx(2 / 12, abs=0.02)


def test_random_spikes_come_every_2_s_and_have_a_heavy_tail() -> None:
    delay_ms = delays_ms(RANDOM, 3000)
    # The first of those that are held up: a rise from one frame to the next, never by jitter.
    rises_ms = np.diff(delay_ms)
    assert (rises_ms > 30).sum() / 3000 == pytest.approx(0.5 * (10 / 30) ** 1.5, rel=0.15)
    assert (rises_ms > 120).sum() / 3000 == pytest.approx(0.5 * (10 / 120) ** 1.5, rel=0.4)
    assert delay_ms.max() < 540


def test_a_lost_segment_is_here_after_a_round_trip_and_three_frames() -> None:
    delay_ms = delays_ms(TCP, 600)
    stalls_ms = delay_ms[1:][np.diff(delay_ms) > 30]
    # A stall within a stall does not show as a rise.
    assert 0.7 < len(stalls_ms) / (0.005 * 120_000) < 1
    assert np.median(stalls_ms) == pytest.approx(75, abs=1)
    assert delay_ms.max() == pytest.approx(220, abs=10)


@pytest.fixture(params=range(24))
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


def test_no_path_is_steeper_than_5_percent() -> None:
    delay_ms = np.random.default_rng(1).normal(20, 3, 4000)
    delay_ms[2000:] += 60
    optimum = best_moving(delay_ms, 0.01)
    path_ms = optimum.best.path_ms
    assert len(path_ms) == 4000
    assert np.abs(path_ms[2:] - path_ms[:-2]).max() <= 0.05 * 2 * FRAME_MS + 1e-9
    # It goes up before the step, which only a clairvoyant can.
    assert path_ms[1999] - path_ms[1000] > 40
    assert optimum.bound_ms <= optimum.best.mean_ms < best_constant_ms(delay_ms, 0.01)
    assert optimum.best.mean_ms < 1.02 * optimum.bound_ms


@pytest.mark.parametrize("late", [0.0, 0.01, 0.1, 0.5])
def test_the_best_constant_has_the_share_late_and_no_smaller_one_has(late: float) -> None:
    delay_ms = np.random.default_rng(2).normal(20, 3, 1000)
    constant_ms = best_constant_ms(delay_ms, late)
    assert (delay_ms > constant_ms).mean() <= late
    assert (delay_ms > constant_ms - 1e-9).mean() > late
