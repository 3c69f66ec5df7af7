import numpy as np
import pytest

from protocol.wire.telemetry import Trace
from soak.felt import FeltLog, felt_again_ns, longest_gap_ns

MS = 1_000_000


def trace(
    from_ms: int, felt_n: list[float], *, scored: bool = True, target_n: float = 0.0
) -> Trace:
    count = len(felt_n)
    now_ns = (from_ms + np.arange(count)) * MS
    felt = np.array(felt_n, float)
    return Trace(now_ns, now_ns, np.full(count, target_n), felt, np.full(count, scored))


def log(*traces: Trace) -> FeltLog:
    result = FeltLog(MS)
    for each in traces:
        result.add(each)
    return result


def test_a_spell_continues_over_a_late_trace_and_ends_where_ticks_are_missing() -> None:
    felt = log(
        trace(0, [0.1] * 100),
        trace(120, [0.1] * 100),
        trace(300, [0.1] * 100),
        trace(400, [0.1] * 100, scored=False),
    )
    assert felt.spells == [(0, 219 * MS), (300 * MS, 399 * MS)]
    assert felt.ticks == 400


def test_slews_are_per_second_across_traces_and_missed_ticks_are_distinguished() -> None:
    felt = log(trace(0, [0.0] * 150), trace(150, [0.02] * 50))
    assert felt.felt_slew_n_per_s == pytest.approx(20.0)
    felt.add(trace(203, [0.5] * 3))
    assert felt.felt_slew_n_per_s == pytest.approx(20.0)
    assert felt.catching_up_n_per_s == pytest.approx(0.48 / 0.004)


def test_between_two_processes_there_is_no_slew() -> None:
    felt = log(trace(0, [0.5] * 20, target_n=0.5), trace(2_000, [0.0] * 200))
    assert (felt.target_slew_n_per_s, felt.felt_slew_n_per_s) == (0.0, 0.0)
    assert felt.felt_n == (0.0, 0.5)


def test_nan_is_counted_and_hides_no_force() -> None:
    felt = log(trace(0, [0.1, float("nan"), -0.2, float("inf"), 0.3]))
    felt.add(trace(5, [0.1]))
    assert (felt.not_finite, felt.felt_n) == (2, (-0.2, 0.3))


SPELLS = [(0, 1_000 * MS), (1_900 * MS, 1_950 * MS), (2_500 * MS, 9_000 * MS)]


def test_felt_again_is_felt_for_good() -> None:
    assert felt_again_ns(SPELLS, 1_100 * MS, 9_000 * MS) == 1_400 * MS
    # Without an interruption, or never.
    assert felt_again_ns(SPELLS, 500 * MS, 9_000 * MS) == 0
    assert felt_again_ns(SPELLS, 1_100 * MS, 2_400 * MS) is None
    assert felt_again_ns([], 0, 9_000 * MS) is None
    # The rest of a touch at the end of the fault is not long enough.
    assert felt_again_ns(SPELLS, 900 * MS, 9_000 * MS) == 1_600 * MS


def test_the_longest_gap_counts_what_is_missing_at_both_ends() -> None:
    assert longest_gap_ns(SPELLS, 0, 9_000 * MS) == 900 * MS
    assert longest_gap_ns(SPELLS, 3_000 * MS, 8_000 * MS) == 0
    assert longest_gap_ns(SPELLS, 8_000 * MS, 9_700 * MS) == 700 * MS
    assert longest_gap_ns([], 100 * MS, 400 * MS) == 300 * MS
