"""Hard cases for the force loop as it is shipped: stable, or refused with a reason."""

import math
import re
from collections import Counter

import numpy as np
import pytest

from display_node.control.pid import Pid
from display_node.scene import DisplayScene
from telepulse.paper import published
from telepulse.paper.stability import BOUND_N, HELD_N, paper_setup
from tests.system.stability import input_cases, loop_cases
from tests.system.stability.hard_case import (
    CaseResult,
    CaseRun,
    CaseVerdict,
    HardCase,
    evaluate,
    judge,
    make_setup,
)
from tests.system.stability.loop_cases import BETWEEN_N, STEPPER, chatter, saturated_steps

STABLE, REFUSED, CYCLES, FAILS, WRONG = CaseVerdict
STEP_M = 0.625e-6
FINGER = make_setup({"kp": 300, "error": "position"}, STEPPER)
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
    ("ν → 0.5", "", {STABLE: 3, REFUSED: 1}),
    ("vanishing thickness", "1e-12", {STABLE: 1}),
    ("vanishing thickness", "5e-324", {REFUSED: 1}),
    ("vanishing thickness", "0.0 m", {REFUSED: 1}),
    ("vanishing modulus", "", {REFUSED: 2}),
    ("extreme ticks", "", {STABLE: 11}),
    ("saturated step rate", "", {STABLE: 6}),
    ("direction chatter", "no dead band", {STABLE: 5, CYCLES: 3}),
    ("direction chatter", ", dead band", {STABLE: 8}),
    ("direction chatter", "as shipped", {STABLE: 4}),
    ("a step of 1 N", "", {STABLE: 8}),
    ("a force spike", "one reference", {STABLE: 4}),
    ("denormals and NaN", "one reference", {STABLE: 4}),
    ("a peer's samples", "holds NaN", {REFUSED: 1}),
    ("a peer's samples", "holds ∞", {REFUSED: 1}),
    ("a peer's samples", "holds −∞", {REFUSED: 1}),
]


@pytest.fixture(scope="module")
def results() -> list[CaseResult]:
    return [*loop_cases.all_cases(), *input_cases.all_cases()]


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
        assert result.reason, result


@pytest.mark.parametrize(("case", "words", "verdicts"), CASES)
def test_each_case_has_its_verdicts(
    results: list[CaseResult], case: str, words: str, verdicts: dict[CaseVerdict, int]
) -> None:
    assert Counter(result.verdict for result in of(results, case, words)) == verdicts


def test_a_refusal_names_its_reason(results: list[CaseResult]) -> None:
    (stiff,) = of(results, "stiff contact", "kp = 10")
    assert re.fullmatch(r"the force loop is not stable \(largest pole 1\.\d+, .*", stiff.reason)
    (beyond,) = of(results, "ν → 0.5", "0.5000001")
    assert beyond.reason == "poisson_ratio is 0.5000001; it must be in 0 to 0.5"
    for scene in ("scenes/bench", "scenes/real_bench"):
        (spike,) = of(results, "a force spike", scene, "reading of 100")
        (no_number,) = of(results, "denormals and NaN", scene, "reading of NaN, ∞, −∞")
        assert spike.verdict == no_number.verdict == REFUSED
        assert spike.reason.endswith("felt force above 2.7 N")
        assert no_number.reason.endswith("feedback is not a number")
    for value in ("NaN", "∞", "−∞"):
        (frames,) = of(results, "a peer's samples", f"holds {value}")
        assert frames.reason == "a frame with a sample that is not finite is counted, not played"


def test_a_step_keeps_the_slew_limit(results: list[CaseResult]) -> None:
    (bench,) = of(results, "a step of 1 N", "/bench", "through")
    assert bench.felt_n is not None
    assert bench.felt_n.max() == pytest.approx(loop_cases.STEP_TO_N, abs=1e-3)
    # The slew limit is 50 N/s, and a microstep more.
    assert np.diff(bench.felt_n[loop_cases.STEP_AT - 1 :]).max() <= 51e-3


# The judgement.


def judged(
    felt_n: float | list[float], *faults: str, loop: DisplayScene = FINGER, since: int = 0
) -> str:
    felt = np.full(100, felt_n) if isinstance(felt_n, float) else np.array(felt_n)
    case = HardCase("", "", loop, "as it should", disturbance_tick=since)
    verdict, reason = judge(case, CaseRun(felt, faults))
    assert reason
    return verdict


def microsteps_from_target_n(steps: float) -> float:
    law = FINGER.actuator.contact(FINGER.layer.layer())  # type: ignore[union-attr]
    return law.force(law.position(HELD_N) + steps * STEP_M)


@pytest.mark.parametrize(
    ("felt_n", "verdict"),
    [
        (HELD_N, STABLE),
        (microsteps_from_target_n(0.99), STABLE),
        (microsteps_from_target_n(-0.99), STABLE),
        (microsteps_from_target_n(1.01), WRONG),
        (microsteps_from_target_n(-1.01), WRONG),
        (math.nan, WRONG),
        ([HELD_N] * 10 + [1.01 * BOUND_N] + [HELD_N] * 100, WRONG),
        ([HELD_N] * 10 + [-1.01 * BOUND_N] + [HELD_N] * 100, WRONG),
        ([math.inf] + [HELD_N] * 100, WRONG),
        ([0.0] + [HELD_N] * 100, STABLE),
    ],
)
def test_a_run_is_judged_by_its_bounds_and_its_end(
    felt_n: float | list[float], verdict: CaseVerdict
) -> None:
    assert judged(felt_n) == verdict


@pytest.mark.parametrize(
    ("after_n", "verdict"),
    [
        ([0.0], REFUSED),
        ([0.39, 0.0], REFUSED),
        ([0.41, 0.0], FAILS),
        ([2e-3], FAILS),
        ([1.01 * BOUND_N, 0.0], FAILS),
        ([math.nan, 0.0], FAILS),
    ],
)
def test_a_fault_must_bring_the_finger_to_rest(after_n: list[float], verdict: CaseVerdict) -> None:
    felt_n = [HELD_N] * 50 + after_n + after_n[-1:] * 200
    assert judged(felt_n, "a fault", since=50) == verdict


def test_on_eq_22_a_hundredth_is_settled() -> None:
    loop = paper_setup(published.EXPERIMENT)
    assert judged(1.009 * HELD_N, loop=loop) == STABLE
    assert judged(1.011 * HELD_N, loop=loop) == WRONG


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


def test_a_cycle_of_two_microsteps_is_measured_and_rest_is_none() -> None:
    between_n = [microsteps_from_target_n(steps) for steps in (0, 1, 2, 1)]
    found = chatter(FINGER, np.array(between_n * 500))
    assert found.microsteps == pytest.approx(2)
    assert found.reversals_hz == pytest.approx(500, rel=0.01)
    assert found.peak_to_peak_n == pytest.approx(between_n[2] - between_n[0])
    assert chatter(FINGER, np.full(1000, BETWEEN_N)) == (0, 0, 0)


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
