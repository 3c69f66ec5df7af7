"""Each check passes what is right, and fails what is fabricated."""

from dataclasses import replace

import numpy as np
import pytest

from protocol.faults import Fault, FaultKind, Part
from protocol.finger import FingerState, WithdrawalOutcome
from soak.accounts import Mark, Session, reckon
from soak.bench_truth import FingerClaim, Round, judge_bench
from soak.felt import Bounds
from soak.verdict import (
    AGAIN_BAR_S,
    judge_recovery,
    judge_safety,
)

MS, S = 1_000_000, 1_000_000_000


@pytest.mark.parametrize(
    ("again_s", "ok"), [([AGAIN_BAR_S], True), ([AGAIN_BAR_S + 0.01], False), ([None], False)]
)
def test_a_recovery_that_takes_too_long_or_never_comes_fails(
    again_s: list[float | None], ok: bool
) -> None:
    assert [x.ok for x in judge_recovery({"kill": again_s, "cut": [0.1]})] == [True, ok, ok]
    assert [x.ok for x in judge_recovery({})] == [False]


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
    bounds = replace(right, **wrong)
    assert [check.ok for check in judge_safety("restarted", bounds, 2.5, 50.0)] == ok


TIMES_NS = np.arange(0, 6_000 * MS, MS)
# Pressed with 245 mN until 3 s, then off the finger.
FORCES_N = np.where(TIMES_NS < 3_000 * MS, 0.245, 0.0)


OFF = FingerState(0.0, 0.0, "", WithdrawalOutcome.WITHDRAWN, True)


def says(at_ms: int, finger: FingerState, state: str = "playing") -> FingerClaim:
    return FingerClaim(at_ms * MS, state, finger)


TRUE = Round(
    "stall 0.40 s",
    [
        says(1_000, FingerState(0.244)),
        says(2_800, FingerState(0.251, 0.0, "", WithdrawalOutcome.UNDER_WAY), "fault"),
        says(3_050, FingerState(0.0, 0.0, "", WithdrawalOutcome.UNDER_WAY), "fault"),
        says(3_400, OFF, "fault"),
    ],
    *(
        3,
        [Fault(FaultKind.NO_COMMAND, Part.DRIVE, "no command for 403 ms")],
        OFF,
        TIMES_NS,
        FORCES_N,
    ),
)


@pytest.mark.parametrize(
    ("played", "failed"),
    [
        (TRUE, ""),
        (replace(TRUE, claims=[says(1_000, OFF)]), "finger"),
        (replace(TRUE, claims=[says(2_000, FingerState(0.0))]), "finger"),
        (replace(TRUE, claims=[says(2_000, FingerState(0.339))]), "finger"),
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


FIRST = Session(began_ns=0, ended_ns=10 * S, period_ns=MS, least=10_000, most=10_000)
# Killed at 30 s: the number of samples sent by then is not known exactly.
KILLED = Session(began_ns=20 * S, ended_ns=30 * S, period_ns=MS, least=9_990, most=10_005)
KILL = (30 * S, 32 * S)
PLAYED, REPORTED = (5, "playing", 4_900), (15, "ended", 10_000)


def marks(*rows: tuple[float, str, int]) -> list[Mark]:
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
