"""Claims of a bench, against a motor's record; each check fails a fabricated error."""

from dataclasses import replace

import numpy as np
import pytest

from soak.bench_truth import FingerClaim, Round, judge_bench

MS = 1_000_000
LEFT = "off the finger after a fault"
TIMES_NS = np.arange(0, 6_000 * MS, MS)
# Pressed with 245 mN until 3 s, then off the finger.
FORCES_N = np.where(TIMES_NS < 3_000 * MS, 0.245, 0.0)


def claim(at_ms: int, finger: str, state: str = "fault") -> FingerClaim:
    return FingerClaim(at_ms * MS, state, finger)


TRUE = Round(
    "stall 0.40 s",
    [
        claim(1_000, "pressed with 244 mN", "playing"),
        claim(2_800, "pressed with 251 mN, withdrawing"),
        claim(3_050, "not pressed, withdrawing"),
        claim(3_400, "withdrawn"),
        claim(3_600, "force unknown since 3 s"),
    ],
    3,
    ["drive: no command: for 403 ms"],
    "withdrawn",
    TIMES_NS,
    FORCES_N,
)


def failed(*rounds: Round) -> list[str]:
    return [
        check.name.removeprefix("bench: ") for check in judge_bench(rounds, []) if check.ok is False
    ]


def test_right_statements_of_a_bench_pass() -> None:
    assert failed(TRUE) == []
    assert [check.ok for check in judge_bench([TRUE], ["one was not felt"])] == [True] * 4


def test_a_soak_whose_bench_was_never_felt_is_not_passed() -> None:
    assert [check.ok for check in judge_bench([], ["not felt"])] == [False, None, None, None]


@pytest.mark.parametrize(
    ("error", "checks"),
    [
        (replace(TRUE, claims=[claim(1_000, "withdrawn")]), ["finger", LEFT]),
        (replace(TRUE, claims=[claim(2_000, "not pressed", "playing")]), ["finger"]),
        (replace(TRUE, claims=[claim(2_000, "pressed with 339 mN", "playing")]), ["finger"]),
        (replace(TRUE, claims=[claim(4_000, "pressed with 245 mN")]), ["finger"]),
        (replace(TRUE, status=0), ["ends"]),
        (replace(TRUE, faults=[]), ["ends"]),
        # The tip stays where it was, and the summary claims that it has left.
        (replace(TRUE, force_n=np.full(len(TIMES_NS), 0.245)),
         ["finger", "ends", LEFT]),
    ],
)  # fmt: skip
def test_a_wrong_statement_of_a_bench_fails(error: Round, checks: list[str]) -> None:
    assert failed(error) == checks


def test_a_tip_that_comes_back_after_it_was_withdrawn_fails() -> None:
    again_n = FORCES_N.copy()
    again_n[5_000:5_100] = 0.02
    assert failed(replace(TRUE, force_n=again_n)) == ["finger", LEFT]
