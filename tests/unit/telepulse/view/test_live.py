from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.summary.fields import SampleCounts
from telepulse.view.live import LiveState
from telepulse.view.tables import RollingTable, thin
from telepulse.view.text import LOST
from tests.unit.telepulse.view.page_states import MS, SimulatedDisplay

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


def test_losses_are_of_the_last_second_at_the_rate_at_which_statuses_come() -> None:
    display = SimulatedDisplay(LiveState())
    shares = []
    for number in range(8):
        # A display with blocks of 0.1 s sends a status each 0.4 s. At 0.8 s samples are lost.
        display.at_ns += 400 * MS
        lost = 100 if number >= 2 else 0
        counts = SampleCounts(400 * number, 400 * number - lost, 0, 0, lost, 0)
        display.status("playing", samples=asdict(counts))
        shares.append(float(display.live.statuses.since(0).values[-1, LOST]))
    assert shares[1:3] == [0, pytest.approx(100 / 8)]
    # Within 1 to 1.4 s the loss is over.
    assert [share > 0 for share in shares[2:]] == [True, True, True, False, False, False]
