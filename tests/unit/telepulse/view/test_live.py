import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from telepulse.view.tables import RollingTable, thin

CAPACITY = 100


@given(st.lists(st.integers(1, CAPACITY), max_size=30))
def test_the_newest_rows_are_kept_and_counted(blocks: list[int]) -> None:
    rolling = RollingTable(1, CAPACITY)
    total = 0
    for count in blocks:
        t_ns = np.arange(total, total + count, dtype=np.int64)
        rolling.insert(t_ns, t_ns[:, np.newaxis] * 2.0)
        total += count
    stretch = rolling.since(0)
    assert min(total, CAPACITY) <= len(stretch.t_ns) <= 2 * CAPACITY
    assert stretch.t_ns.tolist() == list(range(stretch.first, total))
    assert stretch.values[:, 0].tolist() == [2.0 * t for t in stretch.t_ns.tolist()]


@given(st.integers(2, 5_000), st.integers(0, 100))
def test_a_thinned_curve_keeps_its_extremes_and_order(count: int, first: int) -> None:
    t_ns = np.arange(first, first + count, dtype=np.int64)
    values = np.random.default_rng(count).normal(size=count)
    thin_t_ns, thin_values = thin(first, t_ns, values, 200, 10)
    assert len(thin_t_ns) <= 201
    assert np.all(np.diff(thin_t_ns) >= 0)
    assert thin_t_ns[-1] == t_ns[-1]
    stride = 2 * -(-count // 200)
    inner = values[2 * stride : -2 * stride]
    if len(inner):
        assert thin_values.max() >= inner.max()
        assert thin_values.min() <= inner.min()


def test_nan_values_leave_a_gap() -> None:
    values = np.ones(2_000)
    values[500:1_000] = np.nan
    _, thinned = thin(0, np.arange(2_000, dtype=np.int64), values, 200, 10)
    assert 25 < np.isnan(thinned).sum() < 35
