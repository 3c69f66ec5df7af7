import numpy as np
import pytest

from protocol.wire.telemetry import Trace
from soak.core_time import CoreTime, Excused, excuse
from soak.felt import Bounds, FeltLog, felt_again_ns, longest_gap_ns
from soak.slope import slope

MS = 1_000_000


def trace(from_ms: int, felt_n: list[float], full: bool = True) -> Trace:
    count = len(felt_n)
    now_ns, felt = (from_ms + np.arange(count)) * MS, np.array(felt_n, float)
    return Trace(now_ns, now_ns, np.zeros(count), felt, np.full(count, full))


def log(*traces: Trace) -> FeltLog:
    found = FeltLog(MS)
    for each in traces:
        found.add_trace(each)
    return found


def test_spells_interruptions_and_misses_are_kept_apart_by_process() -> None:
    felt = log(trace(0, [0.1] * 20), trace(20, [0.1] * 20, full=False), trace(90, [0.1] * 20))
    assert felt.spells == [(0, 19 * MS), (90 * MS, 109 * MS)]
    assert felt.interruptions == [(19 * MS, 90 * MS, 20)]
    assert felt.misses == [(39 * MS, 90 * MS, 50)]
    assert felt.gaps == [(39 * MS, 90 * MS, True)]
    felt.begin_process()
    felt.add_trace(trace(900, [0.1] * 20))
    assert len(felt.interruptions) == len(felt.misses) == len(felt.gaps) == 1
    assert (felt.ticks, felt.full, felt.last) == (80, 60, (919 * MS, 0.1, True))
    assert felt.newest_ns(500 * MS) == 109 * MS
    assert felt.between(300 * MS, 800 * MS).low_n is None
    assert log().spells == log().misses == log().interruptions == []


def test_slews_after_missed_ticks_are_apart_and_none_is_between_processes() -> None:
    felt = log(trace(0, [0.0] * 150), trace(150, [0.02] * 50))
    assert felt.bounds().felt_slew_n_per_s == pytest.approx(20.0)
    felt.add_trace(trace(203, [0.5, float("nan"), 0.5]))
    felt.add_trace(trace(2_000, [-0.2]))
    assert felt.bounds() == Bounds(
        204, (0.0, 0.0), (-0.2, 0.5), 0.0, pytest.approx(20.0), pytest.approx(0.48 / 0.004), 1
    )


def test_felt_again_is_felt_for_good_and_gaps_count_at_both_ends() -> None:
    spells = [(0, 1_000 * MS), (1_900 * MS, 1_950 * MS), (2_500 * MS, 9_000 * MS)]
    assert felt_again_ns(spells, 1_100 * MS, 9_000 * MS) == 1_400 * MS
    assert felt_again_ns(spells, 500 * MS, 9_000 * MS) == 0
    assert felt_again_ns(spells, 1_100 * MS, 2_400 * MS) is None
    # The rest of a touch at the end of the fault is not long enough.
    assert felt_again_ns(spells, 900 * MS, 9_000 * MS) == 1_600 * MS
    for from_ms, until_ms, gap_ms in ((0, 9_000, 900), (3_000, 8_000, 0), (8_000, 9_700, 700)):
        assert longest_gap_ns(spells, from_ms * MS, until_ms * MS) == gap_ms * MS
    assert longest_gap_ns([], 100 * MS, 400 * MS) == 300 * MS


def reading(at_ms: int, waited_ms: float, stolen_ms: int = 0, processor: int = 0) -> CoreTime:
    return CoreTime(at_ms * MS, round(waited_ms * MS), processor, stolen_ms * MS)


@pytest.mark.parametrize(
    ("gap_ms", "after", "excused"),
    [
        # 3 ms of waiting; the 4th missed tick is the loop's own.
        ((4, 9, 4), reading(20, 3.2), Excused(waited=3)),
        ((4, 9, 4), reading(20, 0.0), Excused()),
        ((4, 19, 14), reading(20, 3.0, stolen_ms=10), Excused(3, 10)),
        # Of another processor nothing was stolen from the loop.
        ((4, 19, 14), reading(20, 3.0, 10, processor=1), Excused(3, 0)),
        # It waited at another time.
        ((24, 29, 4), reading(20, 9.0), Excused()),
    ],
)
def test_a_miss_is_excused_by_as_much_as_the_machine_took_meanwhile(
    gap_ms: tuple[int, int, int], after: CoreTime, excused: Excused
) -> None:
    begin, end, missed = gap_ms
    last = CoreTime(40 * MS, after.waited_ns, after.processor, after.stolen_ns)
    assert excuse([(begin * MS, end * MS, missed)], [reading(0, 0.0), after, last], MS) == excused


def test_a_slope_holds_against_outliers_and_wandering_memory_is_not_growing() -> None:
    rng, times_s = np.random.default_rng(2), np.arange(0.0, 300.0, 2.0)
    values = 40.0 + 0.01 * times_s + rng.normal(0.0, 0.1, 150)
    values[[7, 90, 140]] += 500.0
    found = slope([(times_s, values)])
    assert found is not None
    assert found.low < 0.01 < found.high < 0.02
    # If the samples counted as independent, the slope would be significant in nearly all runs.
    walks = [np.cumsum(rng.normal(0.0, 0.01, 150)) for _ in range(50)]
    slopes = [walk for values in walks if (walk := slope([(times_s, values)])) is not None]
    assert sum(not walk.low <= 0.0 <= walk.high for walk in slopes) < 25
    assert slope([(times_s[:29], times_s[:29])]) is None
