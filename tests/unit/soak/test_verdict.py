"""Each check passes what is right, and fails what is fabricated."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from protocol.wire.telemetry import Trace
from soak.accounts import Mark, Reckoning, Session, reckon, unaccounted
from soak.bench_truth import FingerClaim, Round, judge_bench
from soak.core_time import CoreTime, Excused, excuse
from soak.faults import Done, Played, recoveries, undisturbed_gaps_s
from soak.felt import Bounds, FeltLog
from soak.schedule import (
    BENCH_KINDS,
    CONTINUOUS,
    ENDING_DECKS,
    KINDS,
    RESTARTED,
    SENSING_ENDS,
    Fault,
    episodes,
    troubles,
)
from soak.slope import slope
from soak.verdict import (
    AGAIN_BAR_S,
    MEMORY_BAR_MB_PER_H,
    MEMORY_MAX_MB,
    Line,
    LoopFigures,
    judge_account,
    judge_calm_loop,
    judge_loop,
    judge_recovery,
    judge_safety,
    judge_untouched,
    judge_usage,
)

MS, S = 1_000_000, 1_000_000_000


@pytest.mark.parametrize("seed", range(5))
def test_the_schedule_has_every_kind_in_turn_and_ends_no_sensing_node_at_last(seed: int) -> None:
    found = list(islice(episodes(seed), 400))
    assert found == list(islice(episodes(seed), 400))
    faults = [fault for episode in found for fault in episode.faults]
    kinds = [fault.kind for fault in faults]
    # A fault that was postponed for its partner is one place late.
    assert set(kinds[: len(KINDS) + 1]) == set(KINDS)
    assert sum(kind in SENSING_ENDS for kind in kinds) == ENDING_DECKS * len(SENSING_ENDS)
    assert {x.target for x in faults if x.kind.endswith(("kill display", "restart display"))} == {
        RESTARTED
    }
    for first, *more in (episode.faults for episode in found):
        assert all(x.target != first.target and 0 <= x.after_s <= first.for_s for x in more)
    bench = [trouble.kind for trouble in islice(troubles(seed), len(BENCH_KINDS))]
    assert (bench[0], set(bench)) == ("long stall", set(BENCH_KINDS))


def line(mb_per_h: float = 0.0, handles_per_h: float = 0.0, start_mb: float = 40.0) -> Line:
    times_s = np.arange(0.0, 1_100.0, 2.0)
    hours, noise = times_s / 3600.0, np.random.default_rng(3).normal(0.0, 0.02, len(times_s))
    memory_mb, handles = start_mb + mb_per_h * hours + noise, np.round(20 + handles_per_h * hours)
    return Line(times_s, memory_mb, handles, np.full(len(hours), 4.0), warm=10)


@pytest.mark.parametrize(
    ("lines", "ok"),
    [
        ([line(mb_per_h=0.9 * MEMORY_BAR_MB_PER_H)], [True, True, True]),
        ([line(mb_per_h=1.2 * MEMORY_BAR_MB_PER_H)], [False, True, True]),
        ([line(handles_per_h=60.0)], [True, False, True]),
        ([line(start_mb=MEMORY_MAX_MB + 1.0)], [False, True, True]),
        ([], [None, None, None]),
    ],
)
def test_growth_and_too_large_a_size_fail(lines: list[Line], ok: list[bool | None]) -> None:
    assert [check.ok for check in judge_usage("sensing", lines)] == ok


@pytest.mark.parametrize(
    ("again_s", "ok"), [([AGAIN_BAR_S], True), ([AGAIN_BAR_S + 0.01], False), ([None], False)]
)
def test_a_recovery_that_takes_too_long_or_never_comes_fails(
    again_s: list[float | None], ok: bool
) -> None:
    assert [x.ok for x in judge_recovery({"kill": again_s, "cut": [0.1]})] == [True, ok, ok]
    assert [x.ok for x in judge_recovery({})] == [False]


def test_each_display_is_judged_by_what_was_done_to_it() -> None:
    felt = {CONTINUOUS: FeltLog(MS), RESTARTED: FeltLog(MS)}
    for role, again_s in ((CONTINUOUS, 13.4), (RESTARTED, 12.9)):
        for from_s, until_s in ((0.0, 10.1), (again_s, 60.0)):
            now_ns = np.arange(round(from_s * S), round(until_s * S), 10 * MS)
            force_n = np.zeros(len(now_ns))
            felt[role].add_trace(trace_of(now_ns, force_n))
    both = Done(Fault("kill sensing", "", 0.0, 2.0), 10 * S, 12_500 * MS, (CONTINUOUS, RESTARTED))
    cut = Done(Fault("cut", "", 0.0, 2.0), 10 * S, 13 * S, (CONTINUOUS,))
    found = recoveries([Played((both, cut), 10 * S, 17 * S)], felt)
    assert found["cut + kill sensing"] == found["kill sensing"] == [pytest.approx(0.4)]
    assert undisturbed_gaps_s([Played((cut,), 10 * S, 17 * S)], felt) == [pytest.approx(2.81)]


def trace_of(now_ns: "np.ndarray[tuple[int], np.dtype[np.int64]]", force_n: object) -> Trace:
    values = np.asarray(force_n, float)
    return Trace(now_ns, now_ns, values, values, np.full(len(now_ns), True))


@pytest.mark.parametrize(
    ("wrong", "ok"),
    [
        ({}, [True, True]),
        ({"catching_up_n_per_s": 500.0}, [True, True]),
        ({"felt_n": (0.0, 2.51)}, [False, True]),
        ({"target_n": (-0.01, 1.0)}, [False, True]),
        ({"not_finite": 1}, [False, True]),
        ({"target_slew_n_per_s": 50.1}, [True, False]),
        ({"felt_slew_n_per_s": 55.0}, [True, False]),
    ],
)
def test_force_or_slew_beyond_a_limit_fails(wrong: dict[str, object], ok: list[bool]) -> None:
    right = Bounds(10, (0.0, 2.5), (0.0, 2.5), 50.0, 50.0)
    bounds = replace(right, **wrong)  # type: ignore[arg-type]
    assert [check.ok for check in judge_safety("restarted", bounds, 2.5, 50.0)] == ok


def test_loops_gaps_and_accounts_are_judged_beside_the_calm_display() -> None:
    calm = LoopFigures(ticks=99_000, misses=1_000, tick_p99_us=200.0)
    busy = LoopFigures(ticks=96_000, misses=4_000, tick_p99_us=501.0)
    assert [x.ok for x in judge_loop("restarted", calm, calm)] == [True, True]
    assert [x.ok for x in judge_loop("restarted", busy, calm)] == [False, False]
    assert judge_calm_loop(replace(busy, excused=Excused(waited=3_500)))[0].ok
    # A machine that is too busy proves nothing.
    assert judge_calm_loop(LoopFigures(8_000, 2_000, 200.0, Excused(1_990)))[0].ok is None
    assert [judge_untouched(x, [0.05])[1].ok for x in ([0.1], [0.2])] == [True, False]
    right, open_end = Reckoning(1_000, 1_000, 1_000), Reckoning(900, 850, 1_005)
    assert judge_account("restarted", [right, open_end]).ok
    for wrong in (replace(right, counted=999), replace(open_end, counted=1_006)):
        assert judge_account("restarted", [right, wrong]).ok is False


TIMES_NS = np.arange(0, 6_000 * MS, MS)
# Pressed with 245 mN until 3 s, then off the finger.
FORCES_N = np.where(TIMES_NS < 3_000 * MS, 0.245, 0.0)


def says(at_ms: int, finger: str, state: str = "playing") -> FingerClaim:
    return FingerClaim(at_ms * MS, state, finger)


TRUE = Round(
    "stall 0.40 s",
    [
        says(1_000, "pressed with 244 mN"),
        says(2_800, "pressed with 251 mN, withdrawing", "fault"),
        says(3_050, "not pressed, withdrawing", "fault"),
        says(3_400, "withdrawn", "fault"),
    ],
    *(3, ["drive: no command: for 403 ms"], "withdrawn", TIMES_NS, FORCES_N),
)


@pytest.mark.parametrize(
    ("played", "failed"),
    [
        (TRUE, ""),
        (replace(TRUE, claims=[says(1_000, "withdrawn")]), "finger"),
        (replace(TRUE, claims=[says(2_000, "not pressed")]), "finger"),
        (replace(TRUE, claims=[says(2_000, "pressed with 339 mN")]), "finger"),
        (replace(TRUE, status=0), "ends"),
        (replace(TRUE, faults=[]), "ends"),
        # The tip stays where it was, and the summary claims that it has left.
        (replace(TRUE, force_n=FORCES_N * 0 + 0.245), "finger, ends, off the finger after a fault"),
    ],
)
def test_a_wrong_statement_of_a_bench_fails(played: Round, failed: str) -> None:
    checks = judge_bench([played], [])
    assert ", ".join(x.name.removeprefix("bench: ") for x in checks if x.ok is False) == failed
    assert judge_bench([], ["not felt"])[0].ok is False


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


FIRST = Session(began_ns=0, ended_ns=10 * S, period_ns=MS, least=10_000, most=10_000)
# Killed at 30 s: the number of samples sent by then is not known exactly.
KILLED = Session(began_ns=20 * S, ended_ns=30 * S, period_ns=MS, least=9_990, most=10_005)
KILL = (30 * S, 32 * S)
PLAYED, REPORTED = (5, "playing", 4_900), (15, "ended", 10_000)
Row = tuple[float, str, int]


def marks(*rows: Row) -> list[Mark]:
    return [Mark(round(at_s * S), state, total) for at_s, state, total in rows]


@pytest.mark.parametrize(("total", "off"), [(10_000, 0), (9_999, 1), (10_001, -1), (1, 9_999)])
def test_a_session_whose_end_was_reported_is_accounted_for_to_the_sample(
    total: int, off: int
) -> None:
    (found,) = reckon(marks(PLAYED, (11, "ended", total)), [FIRST], [])
    assert (found.exact, found.off) == (True, off)


@pytest.mark.parametrize(
    ("total", "faults", "off"),
    [
        (20_005, [KILL], 0),
        (19_000, [KILL], 0),
        (18_999, [KILL], 1),
        (20_006, [KILL], -1),
        # A fault shortly after another excuses what began with the first.
        (14_000, [(25 * S, 28 * S), KILL], 0),
        (13_999, [(25 * S, 28 * S), KILL], 1),
    ],
)
def test_only_the_tail_of_a_killed_session_may_be_missing(
    total: int, faults: list[tuple[int, int]], off: int
) -> None:
    rows = marks(PLAYED, REPORTED, (29, "playing", 18_900), (33, "starting", total))
    exact, open_end = reckon(rows, [FIRST, KILLED], faults)
    assert exact.off == 0
    assert (open_end.exact, open_end.off) == (False, off)


@pytest.mark.parametrize(
    ("rows", "off"),
    [
        # A session that was over before the display joined may count or not.
        (((29.9, "waiting", 0), (41, "ended", 8_000)), 0),
        (((29.9, "waiting", 0), (41, "ended", 18_000)), 0),
        (((29.9, "playing", 1), (41, "ended", 8_000)), 9_000),
    ],
)
def test_after_a_killed_session_the_next_end_sums_up_both(rows: tuple[Row, ...], off: int) -> None:
    last = Session(began_ns=32 * S, ended_ns=40 * S, period_ns=MS, least=8_000, most=8_000)
    (found,) = reckon(marks(*rows), [KILLED, last], [])
    assert found.off == off
    assert reckon(marks((5, "waiting", 0)), [FIRST], []) == []


def test_set_points_that_do_not_add_up_are_found() -> None:
    whole = {"sent": 10, "applied": 7, "superseded": 2, "lost": 1}
    assert unaccounted([dict.fromkeys(whole), whole]) == []
    assert unaccounted([whole | {"sent": 11}]) == ["11 sent, 7 + 2 + 1"]
