from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from telepulse.reports.studies.playout_links import best_constant_ms, best_moving, cheapest

FRAME_MS = 5.0
LEVEL_MS = 0.5


def tiny(seed: int, steps: int = 6) -> NDArray[np.float64]:
    """A few frames with delays between 20 and 22 ms, with odd seeds at the ends of that."""
    rng = np.random.default_rng(seed)
    if seed % 2:
        return rng.choice([20.1, 21.9], 2 * steps)
    return 20 + 2 * rng.random(2 * steps)


def every_path_ms(delay_ms: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """All paths of levels 0.5 ms apart that stay or go to a neighbour every two frames."""
    levels_ms = np.arange(40, 45) * LEVEL_MS
    for first in range(len(levels_ms)):
        for moves in product((-1, 0, 1), repeat=len(delay_ms) // 2 - 1):
            positions = first + np.cumsum([0, *moves])
            if positions.min() >= 0 and positions.max() < len(levels_ms):
                yield np.repeat(levels_ms[positions], 2)


def costs(delay_ms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean delay and late share of every path, shape (paths, 2)."""
    return np.array([(path.mean(), (delay_ms > path).mean()) for path in every_path_ms(delay_ms)])


@pytest.mark.parametrize("seed", range(24))
def test_the_cheapest_path_costs_what_trying_all_finds(seed: int) -> None:
    delay_ms = tiny(seed)
    tried = costs(delay_ms)
    for price_ms in (0.0, 0.3, 1.0, 3.0, 10.0, 1000.0):
        found = cheapest(delay_ms, price_ms, FRAME_MS)
        least_ms = (tried @ [1.0, price_ms]).min()
        assert found.delay_ms + price_ms * found.late == pytest.approx(least_ms)
        assert (found.delay_ms, found.late) == (
            found.path_ms.mean(),
            (delay_ms > found.path_ms).mean(),
        )


@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("late", [0.0, 0.1, 0.25])
def test_the_bound_and_the_best_path_enclose_what_trying_all_finds(seed: int, late: float) -> None:
    delay_ms = tiny(seed)
    tried = costs(delay_ms)
    least_ms = tried[tried[:, 1] <= late, 0].min()
    optimum = best_moving(delay_ms, late, FRAME_MS)
    assert optimum.best.late <= late
    assert optimum.bound_ms <= least_ms + 1e-9
    assert optimum.best.delay_ms >= least_ms - 1e-9
    if late == 0:
        assert optimum.best.delay_ms == pytest.approx(least_ms)


def test_no_path_is_steeper_than_5_percent() -> None:
    delay_ms = np.random.default_rng(1).normal(20, 3, 4000)
    delay_ms[2000:] += 60
    optimum = best_moving(delay_ms, 0.01, FRAME_MS)
    path_ms = optimum.best.path_ms
    assert len(path_ms) == 4000
    assert np.abs(path_ms[2:] - path_ms[:-2]).max() <= 0.05 * 2 * FRAME_MS + 1e-9
    # It goes up before the step, which only a clairvoyant can.
    assert path_ms[1999] - path_ms[1000] > 40
    assert optimum.bound_ms <= optimum.best.delay_ms < best_constant_ms(delay_ms, 0.01)
    assert optimum.best.delay_ms < 1.02 * optimum.bound_ms


@pytest.mark.parametrize("late", [0.0, 0.01, 0.1, 0.5])
def test_the_best_constant_has_the_share_late_and_no_smaller_one_has(late: float) -> None:
    delay_ms = np.random.default_rng(2).normal(20, 3, 1000)
    constant_ms = best_constant_ms(delay_ms, late)
    assert (delay_ms > constant_ms).mean() <= late
    assert (delay_ms > constant_ms - 1e-9).mean() > late
