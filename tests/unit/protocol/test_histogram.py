import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.histogram import Histogram, bound

SHARES = [0.0, 0.01, 0.25, 0.5, 0.9, 0.99, 1.0]
BIN, BINS = 0.5, 200


def filled(values: list[float]) -> Histogram:
    histogram = Histogram(BIN, BINS)
    for value in values:
        histogram.add(value)
    return histogram


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=300))
def test_count_mean_and_maximum_are_exact_and_quantiles_rise_to_it(values: list[float]) -> None:
    histogram = filled(values)
    assert histogram.count == len(values)
    assert histogram.mean == pytest.approx(np.mean(values), abs=1e-9)
    assert histogram.maximum == max(values)
    quantiles = [histogram.quantile(share) for share in SHARES]
    known = [quantile for quantile in quantiles if quantile is not None]
    assert len(known) == len(SHARES)
    assert known == sorted(known)
    assert known[-1] <= max(values)


def test_without_values_all_results_are_none() -> None:
    histogram = Histogram(BIN, BINS)
    assert (histogram.count, histogram.mean, histogram.maximum) == (0, None, None)
    assert histogram.quantile(0.5) is None


@pytest.mark.parametrize("largest", [BIN * BINS, 1e3, 5e6, 1e300, math.inf])
def test_a_quantile_beyond_the_range_is_a_lower_bound_and_named(largest: float) -> None:
    histogram = filled([1.2] * 98 + [BIN * BINS, largest])
    found = histogram.quantiles(p50=0.5, p98=0.98, p99=0.99, p999=0.999)
    beyond = found["beyond"]
    assert beyond == ["p99", "p999"]
    assert found["p50"] == histogram.quantile(0.5) == pytest.approx(1.2, abs=BIN)
    assert found["p99"] == histogram.quantile(0.99) == BIN * BINS
    assert (bound("p50", beyond), bound("p99", beyond)) == ("", "> ")
    assert histogram.maximum == largest


@given(st.lists(st.floats(0, 2 * BIN * BINS) | st.floats(0, BIN * BINS), min_size=1, max_size=300))
def test_a_quantile_is_exact_to_one_bin_or_named_beyond_the_range(values: list[float]) -> None:
    histogram = filled(values)
    for share in SHARES:
        exact = np.quantile(values, share, method="inverted_cdf")
        assert histogram.is_beyond(share) == (exact >= BIN * BINS)
        assert histogram.quantile(share) == pytest.approx(min(exact, BIN * BINS), abs=BIN)


def test_nan_is_not_counted() -> None:
    histogram = filled([1.0, math.nan, 1.0])
    assert (histogram.count, histogram.mean) == (2, 1.0)
