from collections.abc import Sequence

import numpy as np
import pytest

from soak.slope import Floats, Slope, slope

TIMES_S = np.arange(0.0, 600.0, 2.0)
STEPS = np.random.default_rng(5)


def noise(scale: float) -> Floats:
    return STEPS.normal(0.0, scale, len(TIMES_S))


def known_slope(lines: Sequence[tuple[Floats, Floats]]) -> Slope:
    found = slope(lines)
    assert found is not None
    return found


def test_a_few_outliers_do_not_change_a_slope() -> None:
    values = 40.0 + 0.01 * TIMES_S + noise(0.1)
    values[[7, 90, 200]] += 500.0
    found = known_slope([(TIMES_S, values)])
    assert found.median == pytest.approx(0.01, rel=0.02)
    assert found.low < 0.01 < found.high
    assert found.high - found.low < 0.001


def test_its_interval_holds_the_truth_about_95_times_of_100() -> None:
    truth, rng = 0.003, np.random.default_rng(1)
    times_s = TIMES_S[:60]
    inside = 0
    for _ in range(200):
        found = known_slope([(times_s, truth * times_s + rng.normal(0.0, 1.0, 60))])
        inside += found.low <= truth <= found.high
    assert 180 <= inside <= 199


def test_memory_that_wanders_is_not_surely_growing() -> None:
    # A random walk has a slope in most of its runs, which proves no growth.
    rng, sure, runs = np.random.default_rng(2), 0, 50
    times_s = TIMES_S[:150]
    for _ in range(runs):
        found = known_slope([(times_s, np.cumsum(rng.normal(0.0, 0.01, len(times_s))))])
        sure += not found.low <= 0.0 <= found.high
    # If the samples counted as independent, the slope would be significant in nearly all runs.
    assert sure < 0.5 * runs


def test_a_step_alone_is_no_slope() -> None:
    values = np.where(TIMES_S < 300.0, 40.0, 41.0)
    found = known_slope([(TIMES_S, values)])
    assert found.low <= 0.0


def test_processes_share_a_slope_and_not_a_level() -> None:
    lines = [
        (TIMES_S[:100], 40.0 + 0.02 * TIMES_S[:100] + noise(0.05)[:100]),
        (TIMES_S[150:], 25.0 + 0.02 * TIMES_S[150:] + noise(0.05)[150:]),
    ]
    found = known_slope(lines)
    assert found.median == pytest.approx(0.02, rel=0.02)
    assert found.low < 0.02 < found.high


def test_a_constant_has_slope_zero_without_uncertainty() -> None:
    found = known_slope([(TIMES_S, np.full(len(TIMES_S), 12.0))])
    assert (found.low, found.median, found.high) == (0.0, 0.0, 0.0)


def test_a_few_samples_have_no_slope() -> None:
    assert slope([]) is None
    assert slope([(TIMES_S[:29], TIMES_S[:29])]) is None
