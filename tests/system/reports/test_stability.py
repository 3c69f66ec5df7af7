import math
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from display_node.control.controller import ControllerScene
from display_node.control.pid import Pid
from protocol.errors import SceneError
from telepulse.reports.document import Report, write_report
from telepulse.reports.paper import published, stability
from telepulse.reports.paper.hard_case import (
    BOUND_N,
    HELD_N,
    CaseResult,
    CaseRun,
    CaseVerdict,
    HardCase,
    LoopSetup,
    evaluate,
    judge,
    make_setup,
    paper_setup,
    scene_setup,
)
from telepulse.reports.paper.loop_cases import BETWEEN_N, STEPPER, chatter, saturated_steps
from telepulse.reports.paper.pulse_spectrum import deviation_n
from telepulse.reports.paper.tick_rates import PEAK_TO_PEAK_N, RATES_HZ, RateResult, measure

STEP_M = 0.625e-6
FINGER = make_setup({"kp": 300, "error": "position"}, STEPPER)
CASES = (
    "stiff contact",
    "nearly undamped",
    "vanishing mass",
    "ν → 0.5",
    "vanishing thickness",
    "vanishing modulus",
    "extreme ticks",
    "saturated step rate",
    "direction chatter",
    "a step of 1 N",
    "a force spike",
    "denormals and NaN",
    "a peer's samples",
)


@pytest.fixture(scope="module")
def rates() -> tuple[RateResult, ...]:
    return measure()


@pytest.fixture(scope="module")
def outcomes() -> tuple[CaseResult, ...]:
    return tuple(stability.case_results())


def of(outcomes: tuple[CaseResult, ...], case: str, *words: str) -> list[CaseResult]:
    found = [
        outcome
        for outcome in outcomes
        if outcome.case == case and all(word in outcome.run for word in words)
    ]
    assert found, (case, words)
    return found


def verdicts(outcomes: tuple[CaseResult, ...], case: str, *words: str) -> Counter[CaseVerdict]:
    return Counter(outcome.verdict for outcome in of(outcomes, case, *words))


# The paper's gains.


def test_the_shipped_pid_follows_at_every_rate(rates: tuple[RateResult, ...]) -> None:
    assert len(rates) == 4 * len(RATES_HZ)
    for each in rates:
        assert each.refused is None
        assert each.shipped_radius < 1
        assert each.shipped_n < 2e-3, each


def test_the_explicit_pid_diverges_just_where_its_poles_say(rates: tuple[RateResult, ...]) -> None:
    for each in rates:
        assert math.isinf(each.explicit_n) == (each.explicit_radius > 1), each
    bare = {(each.gains, each.rate_hz): each for each in rates if each.filter_hz > 1e4}
    assert math.isinf(bare["simulation", 1_000].explicit_n)
    assert bare["experiment", 1_000].explicit_n < 2e-3
    assert math.isinf(bare["experiment", 200].explicit_n)


def test_where_both_follow_they_agree(rates: tuple[RateResult, ...]) -> None:
    for each in rates:
        if each.rate_hz == 10_000 and each.gains == "experiment":
            assert each.shipped_n == pytest.approx(each.explicit_n, rel=0.01)


def test_the_delay_margin_predicts_the_effect_of_a_tick_of_delay(
    rates: tuple[RateResult, ...],
) -> None:
    nothing_n = PEAK_TO_PEAK_N * deviation_n("paper")
    lost = {(each.gains, each.rate_hz) for each in rates if each.late_n > nothing_n}
    assert lost == {("simulation", 100), ("experiment", 100), ("experiment", 200)}
    for each in rates:
        if each.late_n > nothing_n:
            assert each.delay_ticks < 1.025
        else:
            assert each.delay_ticks > 1.025


# Every other case.


@pytest.mark.parametrize("case", CASES)
def test_every_case_is_stable_or_refused_with_a_reason(
    outcomes: tuple[CaseResult, ...], case: str
) -> None:
    for outcome in of(outcomes, case):
        assert outcome.verdict not in (CaseVerdict.FAILS, CaseVerdict.WRONG), outcome


def test_every_row_has_its_figure_and_reason(outcomes: tuple[CaseResult, ...]) -> None:
    assert {outcome.case for outcome in outcomes} == set(CASES)
    for outcome in outcomes:
        assert outcome.reason, outcome
        assert outcome.figure != "–" or outcome.verdict in (CaseVerdict.REFUSED, CaseVerdict.FAILS)


def test_stiff_contact_is_stable_up_to_what_is_refused(outcomes: tuple[CaseResult, ...]) -> None:
    assert verdicts(outcomes, "stiff contact") == {CaseVerdict.STABLE: 12, CaseVerdict.REFUSED: 1}
    (refused,) = of(outcomes, "stiff contact", "kp = 10")
    assert re.fullmatch(r"the force loop is not stable \(largest pole 1\.\d+, .*", refused.reason)


@pytest.mark.parametrize("damping", ["ζ = 1e-06", "ζ = 0,"])
def test_a_rotor_that_rings_for_ever_is_refused(
    outcomes: tuple[CaseResult, ...], damping: str
) -> None:
    assert verdicts(outcomes, "nearly undamped", damping) == {CaseVerdict.REFUSED: 2}
    assert verdicts(outcomes, "nearly undamped", "ζ = 0.2") == {CaseVerdict.STABLE: 2}


def test_eq_22_without_damping_needs_a_derivative(outcomes: tuple[CaseResult, ...]) -> None:
    assert verdicts(outcomes, "nearly undamped", "gains on mV") == {CaseVerdict.STABLE: 2}
    assert verdicts(outcomes, "nearly undamped", "proportional") == {CaseVerdict.REFUSED: 2}


def test_the_layer_up_to_its_limits(outcomes: tuple[CaseResult, ...]) -> None:
    assert verdicts(outcomes, "ν → 0.5") == {CaseVerdict.STABLE: 3, CaseVerdict.REFUSED: 1}
    (beyond,) = of(outcomes, "ν → 0.5", "0.5000001")
    assert beyond.reason == "poisson_ratio is 0.5000001; it must be in 0 to 0.5"
    assert verdicts(outcomes, "vanishing thickness", "1e-12") == {CaseVerdict.STABLE: 1}
    for thickness in ("5e-324", "0.0 m"):
        assert verdicts(outcomes, "vanishing thickness", thickness) == {CaseVerdict.REFUSED: 1}


def test_a_microsecond_and_a_tenth_of_a_second_are_ticks(outcomes: tuple[CaseResult, ...]) -> None:
    assert verdicts(outcomes, "extreme ticks") == {CaseVerdict.STABLE: 11}


def test_saturation_winds_nothing_up(outcomes: tuple[CaseResult, ...]) -> None:
    assert verdicts(outcomes, "saturated step rate") == {CaseVerdict.STABLE: 6}


def test_no_limit_cycle_of_more_than_a_microstep_is_left_by_a_dead_band(
    outcomes: tuple[CaseResult, ...],
) -> None:
    assert verdicts(outcomes, "direction chatter", "no dead band")[CaseVerdict.CYCLES] == 3
    assert set(verdicts(outcomes, "direction chatter", ", dead band")) == {CaseVerdict.STABLE}


def test_no_shipped_scene_cycles(outcomes: tuple[CaseResult, ...]) -> None:
    assert verdicts(outcomes, "direction chatter", "as shipped") == {CaseVerdict.STABLE: 4}


def test_a_step_keeps_the_slew_limit(outcomes: tuple[CaseResult, ...]) -> None:
    assert verdicts(outcomes, "a step of 1 N") == {CaseVerdict.STABLE: 8}
    (bench,) = of(outcomes, "a step of 1 N", "/bench", "through")
    assert bench.figure.startswith("overshoot 0.0 %, within 2 % after 2")
    assert float(bench.figure.split()[-2]) <= 51


def test_no_reference_gets_past_safety(outcomes: tuple[CaseResult, ...]) -> None:
    for case in ("a force spike", "denormals and NaN"):
        assert verdicts(outcomes, case, "one reference") == {CaseVerdict.STABLE: 4}


@pytest.mark.parametrize("scene", ["scenes/bench", "scenes/real_bench"])
def test_a_reading_that_cannot_be_brings_a_stepper_to_rest(
    outcomes: tuple[CaseResult, ...], scene: str
) -> None:
    (spike,) = of(outcomes, "a force spike", scene, "reading of 100")
    (no_number,) = of(outcomes, "denormals and NaN", scene, "reading of NaN, ∞, −∞")
    assert spike.verdict == no_number.verdict == CaseVerdict.REFUSED
    assert spike.reason.endswith("felt force above 2.7 N")
    assert no_number.reason.endswith("feedback is not a number")


@pytest.mark.parametrize("held", ["NaN", "∞", "−∞"])
def test_a_peers_samples_that_are_no_numbers_are_counted(
    outcomes: tuple[CaseResult, ...], held: str
) -> None:
    (outcome,) = of(outcomes, "a peer's samples", f"holds {held}")
    assert outcome.verdict is CaseVerdict.REFUSED
    assert outcome.figure.startswith("150 of 150 odd frames refused")


# What judges them.


def judged(
    felt_n: float | list[float], *faults: str, loop: LoopSetup = FINGER, since: int = 0
) -> str:
    felt = np.full(100, felt_n) if isinstance(felt_n, float) else np.array(felt_n)
    verdict, reason = judge(
        HardCase("", "", loop, "as it should", disturbed_at=since), CaseRun(felt, faults)
    )
    assert reason
    return verdict


def microsteps_from_target_n(steps: float) -> float:
    law = STEPPER_LAW
    return law.force(law.position(HELD_N) + steps * STEP_M)


STEPPER_LAW = FINGER.actuator.contact(FINGER.layer)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("felt_n", "verdict"),
    [
        (HELD_N, CaseVerdict.STABLE),
        (microsteps_from_target_n(0.99), CaseVerdict.STABLE),
        (microsteps_from_target_n(-0.99), CaseVerdict.STABLE),
        (microsteps_from_target_n(1.01), CaseVerdict.WRONG),
        (microsteps_from_target_n(-1.01), CaseVerdict.WRONG),
        (math.nan, CaseVerdict.WRONG),
        ([HELD_N] * 10 + [1.01 * BOUND_N] + [HELD_N] * 100, CaseVerdict.WRONG),
        ([HELD_N] * 10 + [-1.01 * BOUND_N] + [HELD_N] * 100, CaseVerdict.WRONG),
        ([math.inf] + [HELD_N] * 100, CaseVerdict.WRONG),
        ([0.0] + [HELD_N] * 100, CaseVerdict.STABLE),
    ],
)
def test_a_run_is_judged_by_its_bounds_and_its_end(
    felt_n: float | list[float], verdict: CaseVerdict
) -> None:
    assert judged(felt_n) == verdict


@pytest.mark.parametrize(
    ("after_n", "verdict"),
    [
        ([0.0], CaseVerdict.REFUSED),
        ([0.39, 0.0], CaseVerdict.REFUSED),
        ([0.41, 0.0], CaseVerdict.FAILS),
        ([2e-3], CaseVerdict.FAILS),
        ([1.01 * BOUND_N, 0.0], CaseVerdict.FAILS),
        ([math.nan, 0.0], CaseVerdict.FAILS),
    ],
)
def test_a_fault_must_bring_the_finger_to_rest(after_n: list[float], verdict: CaseVerdict) -> None:
    felt_n = [HELD_N] * 50 + after_n + after_n[-1:] * 200
    assert judged(felt_n, "a fault", since=50) == verdict


def test_on_eq_22_a_hundredth_is_settled() -> None:
    loop = paper_setup(published.EXPERIMENT, 200.0, 1e-3)
    assert judged(1.009 * HELD_N, loop=loop) == CaseVerdict.STABLE
    assert judged(1.011 * HELD_N, loop=loop) == CaseVerdict.WRONG


def test_an_unstable_loop_is_refused_by_the_display_itself() -> None:
    ringing = make_setup({"kp": 390, "error": "position"}, {**STEPPER, "rotor_resonance": "100 Hz"})
    with pytest.raises(SceneError, match="not stable"):
        ringing.loop()
    outcome = evaluate(HardCase("", "", ringing))
    assert outcome.verdict is CaseVerdict.REFUSED
    assert "\n" not in outcome.reason


def test_an_unstable_loop_that_is_not_refused_is_a_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("display_node.control.force_loop.refuse_unstable", lambda *_: None)
    rotor = {**STEPPER, "rotor_resonance": "100 Hz", "rotor_damping": 0.0}
    outcome = evaluate(
        HardCase("", "", make_setup({"kp": 100, "error": "position"}, rotor), with_safety=False)
    )
    assert outcome.verdict is CaseVerdict.WRONG
    assert outcome.reason == "felt beyond 2.7 N"


def test_a_cycle_of_two_microsteps_is_measured() -> None:
    between_n = [microsteps_from_target_n(steps) for steps in (0, 1, 2, 1)]
    found = chatter(FINGER, np.array(between_n * 500))
    assert found.microsteps == pytest.approx(2)
    assert found.reversals_hz == pytest.approx(500, rel=0.01)
    assert found.peak_to_peak_n == pytest.approx(between_n[2] - between_n[0])


def test_at_rest_there_is_no_chatter() -> None:
    found = chatter(FINGER, np.full(1000, BETWEEN_N))
    assert (found.microsteps, found.reversals_hz, found.peak_to_peak_n) == (0, 0, 0)


class WindingUp(Pid):
    """A PID whose integral goes on in saturation, at a third of its rate."""

    def step(
        self,
        error: float,
        response: float = 0.0,
        feed: float = 0.0,
        least: float = -math.inf,
        most: float = math.inf,
    ) -> float:
        before = self._integral
        output = super().step(error, response, feed, least, most)
        if self._integral == before:
            self._integral += 0.3 * self._ki_tick * (error - response * output)
        return output


def test_windup_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    def winding(scene: ControllerScene, tick_s: float, limit: float) -> Pid:
        return WindingUp(scene.kp, scene.ki, scene.kd, 100.0, tick_s, limit)

    monkeypatch.setattr(ControllerScene, "pid", winding)
    by_name = {outcome.run.split(",")[0]: outcome for outcome in saturated_steps()}
    wound_up = by_name["position with ki = 500"]
    assert (wound_up.verdict, wound_up.reason) == (CaseVerdict.WRONG, "winds up")
    assert by_name["feed-forward"].verdict is CaseVerdict.STABLE


def test_a_setup_is_the_scenes() -> None:
    bench = scene_setup("real_bench")
    assert bench.controller.observer is not None
    assert bench.film.adc_bits == 16
    assert bench.tick_s == 1e-3


# The chapter.


def test_the_chapter_reports_the_results(
    outcomes: tuple[CaseResult, ...],
    rates: tuple[RateResult, ...],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(stability, "measure", lambda: rates)
    monkeypatch.setattr(stability, "case_results", lambda: outcomes)
    chapter = stability.chapter()
    assert [len(table.rows) for table in chapter.tables] == [28, len(outcomes)]
    assert "0 of 28 loops diverge" in chapter.paragraphs[1]
    for outcome in outcomes:
        wrong = outcome.verdict in (CaseVerdict.FAILS, CaseVerdict.WRONG)
        assert (f"{outcome.run} ({outcome.verdict})" in chapter.paragraphs[2]) == wrong
    page = write_report(Report("", (chapter,)), tmp_path).read_text("utf-8")
    assert not re.search(r"\b(nan|inf|None)\b", page)
    for theme in ("light", "dark"):
        assert (tmp_path / f"stability-{theme}.png").read_bytes().startswith(b"\x89PNG")
