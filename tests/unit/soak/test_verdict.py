from dataclasses import replace

import numpy as np
import pytest

from soak.accounts import Reckoning
from soak.felt import FeltLog
from soak.schedule import TEMPORARY
from soak.verdict import (
    AGAIN_BAR_S,
    MEMORY_BAR_MB_PER_H,
    MEMORY_MAX_MB,
    Line,
    LoopFigures,
    judge_account,
    judge_calm_loop,
    judge_loop,
    judge_none,
    judge_recovery,
    judge_safety,
    judge_untouched,
    judge_usage,
)

TIMES_S = np.arange(0.0, 1_100.0, 2.0)


def line(mb_per_h: float = 0.0, handles_per_h: float = 0.0, start_mb: float = 40.0) -> Line:
    hours, noise = TIMES_S / 3600.0, np.random.default_rng(3)
    return Line(
        TIMES_S,
        start_mb + mb_per_h * hours + noise.normal(0.0, 0.02, len(hours)),
        np.round(20.0 + handles_per_h * hours),
        np.full(len(hours), 4.0),
        warm=10,
    )


def first(line: Line, count: int) -> Line:
    columns = (line.times_s, line.memory_mb, line.handles, line.threads)
    return Line(*(column[:count] for column in columns), warm=10)


BAR = MEMORY_BAR_MB_PER_H
WARMING = line()
WARMING.memory_mb[:10] -= np.linspace(20.0, 0.0, 10)


@pytest.mark.parametrize(
    ("lines", "memory", "others"),
    [
        ([line()], True, [True, True]),
        ([line(mb_per_h=0.9 * BAR)], True, [True, True]),
        ([line(mb_per_h=1.2 * BAR)], False, [True, True]),
        ([line(handles_per_h=60.0)], True, [False, True]),
        ([line(start_mb=MEMORY_MAX_MB + 1.0)], False, [True, True]),
        ([WARMING], True, [True, True]),
        # A short run proves nothing, but for memory that is too large.
        ([], None, [None, None]),
        ([first(line(mb_per_h=1_000.0), 39)], None, [None, None]),
        ([first(line(start_mb=MEMORY_MAX_MB + 1.0), 20)], False, [None, None]),
        # A minute slightly above the bar is within the noise of memory.
        ([first(line(mb_per_h=1.1 * BAR), 41)], True, [True, True]),
    ],
)
def test_growth_after_the_warm_up_and_too_large_a_size_fail(
    lines: list[Line], memory: bool | None, others: list[bool | None]
) -> None:
    assert [check.ok for check in judge_usage("sensing", lines)] == [memory, *others]


@pytest.mark.parametrize(
    ("again_s", "ok"),
    [
        ([0.2, 0.9, AGAIN_BAR_S], True),
        ([0.2, AGAIN_BAR_S + 0.01], False),
        ([0.2, None], False),
        ([None], False),
    ],
)
def test_a_recovery_that_takes_too_long_or_never_comes_fails(
    again_s: list[float | None], ok: bool
) -> None:
    cut, kill, both = judge_recovery({"kill": again_s, "cut": [0.1]})
    assert (cut.ok, kill.ok, both.ok) == (True, ok, ok)
    # A soak without a fault is not passed.
    assert [check.ok for check in judge_recovery({})] == [False]


def test_one_sample_unaccounted_for_or_made_up_fails() -> None:
    right = Reckoning(counted=1_000, least=1_000, most=1_000)
    open_end = Reckoning(counted=900, least=850, most=1_005)
    assert judge_account("restarted", [right, open_end]).ok
    assert "105 sent and not received" in judge_account("restarted", [right, open_end]).found
    for wrong in (replace(right, counted=999), replace(open_end, counted=1_006)):
        assert judge_account("restarted", [right, wrong]).ok is False
    assert judge_account("restarted", []).ok is None


def felt(**figures: object) -> FeltLog:
    log = FeltLog(1_000_000)
    log.ticks, log.felt_n, log.target_n = 10, (0.0, 2.5), (0.0, 2.5)
    log.target_slew_n_per_s = log.felt_slew_n_per_s = 50.0
    for name, value in figures.items():
        setattr(log, name, value)
    return log


@pytest.mark.parametrize(
    ("figures", "ok"),
    [
        ({}, [True, True]), ({"catching_up_n_per_s": 500.0}, [True, True]),
        ({"felt_n": (0.0, 2.51)}, [False, True]), ({"target_n": (-0.01, 1.0)}, [False, True]),
        ({"not_finite": 1}, [False, True]), ({"target_slew_n_per_s": 50.1}, [True, False]),
        ({"felt_slew_n_per_s": 55.0}, [True, False]),
    ],
)  # fmt: skip
def test_force_or_slew_beyond_a_limit_fails(figures: dict[str, object], ok: list[bool]) -> None:
    assert [check.ok for check in judge_safety("restarted", felt(**figures), 2.5, 50.0)] == ok


def test_a_force_that_was_not_felt_is_not_judged() -> None:
    assert [check.ok for check in judge_safety(TEMPORARY, FeltLog(1_000_000), 2.5, 50.0)] == [None]


CALM = LoopFigures(ticks=99_000, misses=1_000, tick_p99_us=200.0)


@pytest.mark.parametrize(
    ("figures", "ok"),
    [
        (CALM, True),
        (LoopFigures(ticks=96_000, misses=4_000, tick_p99_us=501.0), False),
        (LoopFigures(ticks=0, misses=0, tick_p99_us=0.0), False),
    ],
)
def test_a_loop_is_judged_beside_the_calm_one(figures: LoopFigures, ok: bool) -> None:
    assert [check.ok for check in judge_loop("restarted", figures, CALM)] == [ok, ok]


@pytest.mark.parametrize(("misses", "ok"), [(1_000, True), (1_100, False)])
def test_the_calm_loop_has_a_bar(misses: int, ok: bool) -> None:
    assert judge_calm_loop(replace(CALM, misses=misses))[0].ok is ok


@pytest.mark.parametrize(
    ("gaps_s", "calm_s", "ok"),
    [([0.0, 0.1], [0.0], True), ([0.0, 0.2], [0.05], False), ([0.2], [0.3], True), ([], [], True)],
)
def test_an_undisturbed_display_has_no_longer_gaps_than_the_calm_pair(
    gaps_s: list[float], calm_s: list[float], ok: bool
) -> None:
    assert judge_untouched(gaps_s, calm_s)[1].ok is ok


def test_an_entry_in_a_list_that_must_be_empty_fails() -> None:
    assert judge_none("zombies", []).ok
    assert judge_none("zombies", ["one"]).ok is False
