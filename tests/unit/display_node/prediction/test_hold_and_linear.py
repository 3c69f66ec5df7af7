import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.prediction import REACH_NS, PredictorName, build_predictors

MS = 1_000_000
T0_NS = 7_000 * MS
CHEAP: tuple[PredictorName, ...] = ("hold", "linear")


def predicted(
    name: PredictorName, times_ns: list[int], values: list[float], sampled_ns: int
) -> float:
    predictor = build_predictors(name)[0]
    predictor.observe(times_ns, values)
    predictor.work()
    return predictor.predict(sampled_ns)


def line(slope_per_ms: float, count: int, period_ns: int = MS) -> tuple[list[int], list[float]]:
    times_ns = [T0_NS + number * period_ns for number in range(count)]
    return times_ns, [0.3 + slope_per_ms * (t_ns - times_ns[0]) / MS for t_ns in times_ns]


@pytest.mark.parametrize("ahead_ns", [0, 1, 5 * MS, 10**12])
def test_hold_keeps_the_newest_value(ahead_ns: int) -> None:
    times_ns, values = line(0.01, 32)
    assert predicted("hold", times_ns, values, times_ns[-1] + ahead_ns) == values[-1]


@given(st.floats(-1, 1), st.integers(2, 32), st.integers(10_000, 10 * MS), st.integers(0, REACH_NS))
def test_linear_is_exact_on_a_line(
    slope_per_ms: float, count: int, period_ns: int, ahead_ns: int
) -> None:
    times_ns, values = line(slope_per_ms, count, period_ns)
    expected = values[-1] + slope_per_ms * ahead_ns / MS
    got = predicted("linear", times_ns, values, times_ns[-1] + ahead_ns)
    assert got == pytest.approx(expected, abs=1e-9)


def test_linear_looks_no_further_back_than_10_ms() -> None:
    times_ns, values = line(0.01, 32)
    kinked = [99.0] * 21 + values[21:]
    ahead_ns = times_ns[-1] + 5 * MS
    straight = predicted("linear", times_ns, values, ahead_ns)
    assert predicted("linear", times_ns, kinked, ahead_ns) == straight
    kinked[21] = 99.0
    assert predicted("linear", times_ns, kinked, ahead_ns) != straight


@pytest.mark.parametrize("ahead_ns", [21 * MS, 500 * MS, 10**15])
def test_linear_continues_for_20_ms_at_most(ahead_ns: int) -> None:
    times_ns, values = line(0.01, 32)
    got = predicted("linear", times_ns, values, times_ns[-1] + ahead_ns)
    assert got == pytest.approx(values[-1] + 20 * 0.01)


@pytest.mark.parametrize(
    ("times_ns", "values"),
    [([5 * MS], [0.4]), ([5 * MS, 5 * MS, 5 * MS], [0.1, 0.2, 0.4]), ([0, 50 * MS], [0.1, 0.4])],
    ids=["one sample", "equal times", "samples too far apart"],
)
def test_linear_holds_where_there_is_no_slope(times_ns: list[int], values: list[float]) -> None:
    assert predicted("linear", times_ns, values, times_ns[-1] + 7 * MS) == 0.4


@pytest.mark.parametrize("name", CHEAP)
def test_the_order_of_frames_does_not_matter(name: PredictorName) -> None:
    times_ns, values = line(0.01, 30)
    ordered, mixed = build_predictors(name)[0], build_predictors(name)[0]
    for first in (0, 5, 10, 15, 20, 25):
        ordered.observe(times_ns[first : first + 5], values[first : first + 5])
    for first in (0, 10, 5, 25, 20, 15):
        mixed.observe(times_ns[first : first + 5], values[first : first + 5])
    sampled_ns = times_ns[-1] + 8 * MS
    assert mixed.predict(sampled_ns) == ordered.predict(sampled_ns) != 0


@pytest.mark.parametrize("name", CHEAP)
def test_enormous_samples_raise_nothing_and_the_error_is_unknown(name: PredictorName) -> None:
    found = predicted(name, [0, MS], [-1.7e308, 1.7e308], 2 * MS)
    assert found > 0 or math.isnan(found)
    assert build_predictors(name)[0].error_n(20 * MS) is None
