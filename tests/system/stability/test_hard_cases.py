"""Hard cases for the force loop as it is shipped: stable, or refused with a reason."""

import re
from collections import Counter
from itertools import product

import numpy as np
import pytest

from display_node.control.pid import Pid
from tests.system.stability import loop_cases
from tests.system.stability.hard_case import (
    CaseResult,
    CaseVerdict,
    HardCase,
    evaluate,
    make_setup,
)
from tests.system.stability.loop_cases import STEPPER, saturated_steps

STABLE, REFUSED, CYCLES, FAILS, WRONG = CaseVerdict
# Case, words in what was run, and the number of such rows with each verdict.
CASES = [
    ("stiff contact", "", {STABLE: 12, REFUSED: 1}),
    ("nearly undamped", "ζ = 0.2", {STABLE: 2}),
    # A rotor that rings for ever.
    ("nearly undamped", "ζ = 1e-06", {REFUSED: 2}),
    ("nearly undamped", "ζ = 0,", {REFUSED: 2}),
    # Eq 22 without damping needs a derivative.
    ("nearly undamped", "gains on mV", {STABLE: 2}),
    ("nearly undamped", "proportional", {REFUSED: 2}),
    ("vanishing mass", "", {REFUSED: 1}),
    ("extreme ticks", "", {STABLE: 6}),
    ("saturated step rate", "", {STABLE: 6}),
    ("direction chatter", "no dead band", {STABLE: 5, CYCLES: 3}),
    ("direction chatter", ", dead band", {STABLE: 8}),
    ("direction chatter", "as shipped", {STABLE: 4}),
    ("a step of 1 N", "", {STABLE: 8}),
    ("a force spike", "one reference", {STABLE: 16}),
    ("denormals and NaN", "one reference", {STABLE: 16}),
]


@pytest.fixture(scope="module")
def results() -> list[CaseResult]:
    return list(loop_cases.all_cases())


def of(results: list[CaseResult], case: str, *words: str) -> list[CaseResult]:
    found = [one for one in results if one.case == case and all(word in one.run for word in words)]
    assert found, (case, words)
    return found


def test_every_row_is_stable_or_refused_with_its_reason(
    results: list[CaseResult],
) -> None:
    assert {result.case for result in results} == {case for case, _, _ in CASES}
    for result in results:
        assert result.verdict not in (FAILS, WRONG), result
        assert result.reason or result.verdict is STABLE, result


@pytest.mark.parametrize(("case", "words", "verdicts"), CASES)
def test_each_case_has_its_verdicts(
    results: list[CaseResult], case: str, words: str, verdicts: dict[CaseVerdict, int]
) -> None:
    assert Counter(result.verdict for result in of(results, case, words)) == verdicts


def test_a_refusal_names_its_reason(results: list[CaseResult]) -> None:
    (stiff,) = of(results, "stiff contact", "kp = 10")
    assert re.fullmatch(r"the force loop is not stable \(largest pole 1\.\d+, .*", stiff.reason)
    spike = "a force spike", "felt force above 2.7 N"
    no_number = "denormals and NaN", "feedback is not a number"
    readings = {"100": spike, "nan": no_number, "inf": no_number, "-inf": no_number}
    for (number, (case, words)), scene in product(readings.items(), ("bench", "real_bench")):
        (result,) = of(results, case, f"scenes/{scene}", f"reading of {number}")
        assert result.verdict == REFUSED
        assert result.reason.endswith(words)


def test_a_step_keeps_the_slew_limit(results: list[CaseResult]) -> None:
    (bench,) = of(results, "a step of 1 N", "/bench", "through")
    assert bench.felt_n is not None
    assert bench.felt_n.max() == pytest.approx(loop_cases.STEP_TO_N, abs=1e-3)
    # The slew limit is 50 N/s, and a microstep more.
    assert np.diff(bench.felt_n[loop_cases.STEP_AT - 1 :]).max() <= 51e-3


def test_an_unstable_loop_is_refused_by_the_display_itself_and_otherwise_a_defect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rotor: dict[str, object] = {**STEPPER, "rotor_resonance": "100 Hz"}
    ringing = make_setup({"kp": 390, "error": "position"}, rotor)
    result = evaluate(HardCase("", "", ringing))
    assert result.verdict is REFUSED
    assert "not stable" in result.reason
    assert "\n" not in result.reason
    monkeypatch.setattr("display_node.control.force_loop.refuse_unstable", lambda *_: None)
    undamped = make_setup({"kp": 100, "error": "position"}, rotor | {"rotor_damping": 0.0})
    result = evaluate(HardCase("", "", undamped, with_safety=False))
    assert (result.verdict, result.reason) == (WRONG, "felt beyond 2.7 N")


def test_windup_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    step = Pid.step

    def winding_up(pid: Pid, error: float, response: float = 0.0, *others: float) -> float:
        """Let the integral go on in saturation, at a third of its rate."""
        before, output = pid._integral, step(pid, error, response, *others)
        if pid._integral == before:
            pid._integral += 0.3 * pid._ki_tick * (error - response * output)
        return output

    monkeypatch.setattr(Pid, "step", winding_up)
    by_name = {result.run.split(",")[0]: result for result in saturated_steps()}
    wound_up = by_name["position with ki = 500"]
    assert (wound_up.verdict, wound_up.reason) == (WRONG, "winds up")
    assert by_name["feed-forward"].verdict is STABLE
