import math

import numpy as np
import pytest
from scipy.stats import binom

from telepulse.experiment.psychometrics import (
    PAPER,
    IntervalErrors,
    Proportion,
    SimulatedObserver,
    d_prime,
    fit_threshold,
    hits_needed,
    mean_of,
    power,
    probability_of_a,
    proportion_correct,
    trials_needed,
)


def test_the_papers_figure_and_its_exact_interval() -> None:
    assert PAPER.share == pytest.approx(0.66, abs=0.01)
    assert PAPER.interval == pytest.approx((0.2228, 0.9567), abs=1e-4)
    # 4, 5 and 6 heads of six coins: 15 + 6 + 1 of 64.
    assert PAPER.p_value == pytest.approx(22 / 64)


@pytest.mark.parametrize("of", [6, 16, 50])
def test_the_interval_holds_the_true_share_at_least_95_times_of_100(of: int) -> None:
    intervals = [Proportion(hits, of).interval for hits in range(of + 1)]
    for share in np.linspace(0.02, 0.98, 97):
        held = [low <= share <= high for low, high in intervals]
        assert binom.pmf(np.arange(of + 1), of, share)[held].sum() >= 0.95


def test_the_interval_holds_the_share_of_a_simulated_observer() -> None:
    errors, threshold, of = IntervalErrors(0.12, 0.0, 0.12), 0.08, 40
    share, held, sessions = float(probability_of_a(errors, threshold)), 0, 400
    intervals = [Proportion(hits, of).interval for hits in range(of + 1)]
    for seed in range(sessions):
        observer = SimulatedObserver(threshold, seed)
        low, high = intervals[sum(observer.identify(errors) == "A" for _ in range(of))]
        held += low <= share <= high
    assert held >= 0.95 * sessions - 4 * math.sqrt(sessions * 0.95 * 0.05)
    assert held < sessions


def test_power_and_the_number_of_trials() -> None:
    assert hits_needed(6) == 6
    assert hits_needed(16) == 12
    assert hits_needed(4) == 5
    assert power(6, 2 / 3) == pytest.approx((2 / 3) ** 6)
    needed = trials_needed(0.75, 0.8)
    assert needed is not None
    assert all(power(trials, 0.75) >= 0.8 for trials in range(needed, 200))
    assert power(needed - 1, 0.75) < 0.8
    assert trials_needed(0.501, 0.9) is None


def test_a_mean_and_its_interval() -> None:
    mean = mean_of([1, 2, 3, 4, 5] * 20)
    assert mean.value == 3
    # 1.96 standard errors of it.
    assert (mean.low, mean.high) == pytest.approx((3 - 0.277, 3 + 0.277), abs=0.03)


@pytest.mark.parametrize("apart", [0.0, 0.7, 2.0, 4.0])
def test_the_observer_does_as_its_equation_says(apart: float) -> None:
    of = 4_000
    observer = SimulatedObserver(1.0, round(10 * apart))
    right = 0
    for trial in range(of):
        a, b = (apart, 0.0) if trial % 2 else (0.0, apart)
        x = a if trial % 3 else b
        right += observer.identify(IntervalErrors(a, b, x)) == ("A" if trial % 3 else "B")
    share = proportion_correct(apart)
    assert abs(right / of - share) < 4 * math.sqrt(0.25 / of)


def test_d_prime_undoes_the_proportion() -> None:
    for value in (0.3, 1.0, 2.5, 5.0):
        assert d_prime(proportion_correct(value)) == pytest.approx(value)
    assert d_prime(0.4) == 0
    assert math.isinf(d_prime(1.0))


def test_the_threshold_of_an_observer_is_found_again() -> None:
    threshold, trials = 0.05, []
    observer = SimulatedObserver(threshold, 3)
    for number in range(600):
        apart = (0.02, 0.06, 0.12, 0.2)[number % 4]
        errors = IntervalErrors(apart, 0.0, apart * (number % 3 > 0))
        trials.append((errors, observer.identify(errors) == "A"))
    found = fit_threshold(trials)
    assert found is not None
    assert found.low < threshold < found.high
    assert found.value == pytest.approx(threshold, rel=0.25)


def test_an_observer_who_is_never_wrong_has_a_threshold_below_and_no_bound_above_zero() -> None:
    found = fit_threshold([(IntervalErrors(0.1, 0.0, 0.1), True)] * 50)
    assert found is not None
    assert found.low == 0
    assert found.high < 0.1


def test_ratings_fall_with_the_error() -> None:
    observer = SimulatedObserver(0.05, 1)
    means = [np.mean([observer.rate(0.0, error) for _ in range(400)]) for error in (0, 0.1, 0.5)]
    assert means[0] > 4
    assert means[0] > means[1] > means[2] == 1
