import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.prediction import PREDICTORS, SLOPE_REACH_NS, hold, linear

MS = 1_000_000


def line(slope_per_ms: float, count: int, period_ns: int = MS) -> tuple[list[int], list[float]]:
    times_ns = [7_000 * MS + number * period_ns for number in range(count)]
    return times_ns, [0.3 + slope_per_ms * (t_ns - times_ns[0]) / MS for t_ns in times_ns]


@pytest.mark.parametrize("ahead_ns", [0, 1, 5 * MS, 10**12])
def test_hold_keeps_the_newest_value(ahead_ns: int) -> None:
    times_ns, values = line(0.01, 32)
    assert hold(times_ns, values, times_ns[-1] + ahead_ns) == values[-1]


@settings(deadline=None)
@given(
    st.floats(-1, 1),
    st.integers(2, 32),
    st.integers(10_000, 10 * MS),
    st.integers(0, SLOPE_REACH_NS),
)
def test_linear_is_exact_on_a_straight_line(
    slope_per_ms: float, count: int, period_ns: int, ahead_ns: int
) -> None:
    times_ns, values = line(slope_per_ms, count, period_ns)
    expected = values[-1] + slope_per_ms * ahead_ns / MS
    assert linear(times_ns, values, times_ns[-1] + ahead_ns) == pytest.approx(expected, abs=1e-9)


def test_linear_looks_no_further_back_than_10_ms() -> None:
    times_ns, values = line(0.01, 32)
    kinked = [99.0] * 21 + values[21:]
    ahead_ns = times_ns[-1] + 5 * MS
    assert linear(times_ns, kinked, ahead_ns) == linear(times_ns, values, ahead_ns)
    kinked[21] = 99.0
    assert linear(times_ns, kinked, ahead_ns) != linear(times_ns, values, ahead_ns)


@pytest.mark.parametrize("ahead_ns", [21 * MS, 500 * MS, 10**15])
def test_linear_goes_on_for_20_ms_at_most(ahead_ns: int) -> None:
    times_ns, values = line(0.01, 32)
    predicted = linear(times_ns, values, times_ns[-1] + ahead_ns)
    assert predicted == pytest.approx(values[-1] + 20 * 0.01)


@pytest.mark.parametrize(
    ("times_ns", "values"),
    [
        ([5 * MS], [0.4]),
        ([5 * MS, 5 * MS, 5 * MS], [0.1, 0.2, 0.4]),
        ([0, 50 * MS], [0.1, 0.4]),
    ],
    ids=["one sample", "equal times", "samples too far apart"],
)
def test_linear_holds_where_there_is_no_slope(times_ns: list[int], values: list[float]) -> None:
    assert linear(times_ns, values, times_ns[-1] + 7 * MS) == 0.4


@pytest.mark.parametrize("name", PREDICTORS)
def test_the_newest_sample_itself_is_no_prediction(name: str) -> None:
    times_ns, values = line(0.01, 32)
    assert PREDICTORS[name](times_ns, values, times_ns[-1]) == values[-1]


@pytest.mark.parametrize("name", PREDICTORS)
def test_enormous_samples_raise_nothing(name: str) -> None:
    predicted = PREDICTORS[name]([0, MS], [-1.7e308, 1.7e308], 2 * MS)
    assert predicted > 0 or math.isnan(predicted)
