"""The delay at which a trace is felt, and the optima beside what trying all paths finds."""

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.playout import QUICK, felt_delays_ns, links, tune
from benchmarks.playout.links import best_constant_ms, best_moving, cheapest, in_order

MS = 1_000_000


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
    tuned = tune(links.make_trace(links.TCP, QUICK.seconds), QUICK, permitted_late=0.0)
    assert not tuned.reached
    assert tuned.played.late > 0


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
