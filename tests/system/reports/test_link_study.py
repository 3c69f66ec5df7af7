import numpy as np
import pytest

from display_node.control.scene import SafetyScene
from telepulse.reports.studies import link_scores
from telepulse.reports.studies.link_report import advice, least_in_phase, report_links
from telepulse.reports.studies.link_scores import (
    CLASSIC,
    FRESH,
    HOLD,
    PREDICTORS,
    LinkCase,
    LinkEffort,
    LinkResult,
    LinkScores,
    arrivals_ms,
    pooled,
    run_link,
    run_policies,
)
from tests.support.drawn_pulses import Pulse, synthetic_pulses

LITTLE = LinkEffort(seconds=4, settle_seconds=2, seeds=(1,))
FAR = "delay=40ms,jitter=1ms"
STALLS = "delay=40ms,jitter=3ms,loss=1%,transport=tcp"
RESULT = LinkResult(
    in_phase_n=0.03,
    aligned_n=0.01,
    deviation_n=0.1,
    peak_to_peak_n=0.3,
    delay_ms=20.0,
    horizon_ms=5.0,
    longest_ms=9.0,
    predicted=0.5,
    felt=1.0,
    roughness=1.0,
    lost=0.01,
)


def made_up() -> LinkScores:
    """Over its one link the stack is best at 0, the others at 40 ms; auto chooses 20 ms."""
    curves = {}
    for predictor in PREDICTORS:
        at_once = 0.01 if predictor == "stack" else 0.06
        curves[predictor] = {
            0.0: RESULT._replace(in_phase_n=at_once, horizon_ms=44.0),
            40.0: RESULT,
            None: RESULT._replace(in_phase_n=0.045, aligned_n=0.0002),
        }
    return LinkScores({"here": curves}, {}, dict.fromkeys(PREDICTORS, 20.0))


def test_the_delay_that_is_not_buffered_is_predicted_and_both_errors_follow() -> None:
    some = {
        delay_ms: run_link(LinkCase(FAR, "linear", delay_ms), LITTLE)
        for delay_ms in (0.0, 20.0, 80.0)
    }
    for delay_ms, result in some.items():
        assert result.delay_ms == pytest.approx(delay_ms, abs=0.5)
    # A frame's newest sample is on average 2 ms older when it is played than when it came.
    assert some[0.0].horizon_ms == pytest.approx(42, abs=1)
    assert some[20.0].horizon_ms == pytest.approx(22, abs=1)
    assert some[0.0].predicted == 1
    assert some[80.0].horizon_ms == some[80.0].longest_ms == some[80.0].predicted == 0
    hold = run_link(LinkCase(FAR, "hold", 0.0), LITTLE)
    assert some[0.0].in_phase < hold.in_phase < some[80.0].in_phase
    assert some[80.0].aligned < 0.01 < some[0.0].aligned
    assert hold.in_phase == pytest.approx(hold.aligned, rel=0.01)
    assert hold.in_phase_jnd == pytest.approx(hold.in_phase_n / 0.1 / hold.peak_to_peak_n)


def test_a_faded_pulse_is_not_felt_and_not_scored() -> None:
    cut = run_link(LinkCase("delay=20ms,cut.from=4s,cut.for=1s", "hold", 40.0), LITTLE)
    whole = run_link(LinkCase("delay=20ms", "hold", 40.0), LITTLE)
    assert whole.felt == pytest.approx(1, abs=0.001)
    # A second of silence, less what it takes to notice, and the ramp back to full strength.
    silent_s = 1 + SafetyScene().ramp_ns * 1e-9
    assert cut.felt == pytest.approx(1 - silent_s / 4, abs=0.05)
    assert cut.lost == pytest.approx(1 / 6, abs=0.002)
    assert cut.aligned < 0.3


def test_seeds_are_pooled_by_mean_squares_and_the_longest_horizon() -> None:
    both = pooled([RESULT, RESULT._replace(in_phase_n=0.04, lost=0.03, longest_ms=70.0)])
    assert both.in_phase_n == pytest.approx(np.sqrt((0.03**2 + 0.04**2) / 2))
    assert both.lost == pytest.approx(0.02)
    assert both.longest_ms == 70
    assert both.aligned_n == pytest.approx(RESULT.aligned_n)


def test_fresh_samples_beat_a_classic_buffer_and_holding_in_every_cell(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(link_scores, "SCORED_FROM_S", 6.0)
    true = synthetic_pulses(10, seed=1)["variability"]
    true = true / true.std()
    sensed = true + 0.01 * np.random.default_rng(1).standard_normal(len(true))
    played = run_policies(Pulse("variability", sensed, true), STALLS)
    # One frame in a hundred is late: the delay reaches far into the stalls.
    assert 100 < played.classic_delay_ms < 160
    errors = {name: np.array(played.errors[name]) for name in (FRESH, CLASSIC, HOLD)}
    assert np.all(errors[FRESH] < errors[CLASSIC])
    assert np.all(errors[FRESH] < errors[HOLD])
    assert list(played.errors[HOLD]) == sorted(played.errors[HOLD], reverse=True)


def test_over_tcp_frames_arrive_in_order_and_none_is_missing() -> None:
    arrived = arrivals_ms(400, STALLS, seed=1)
    assert np.all(np.diff(arrived) >= 0)
    assert arrived[0] >= 4 + 30
    with pytest.raises(ValueError, match="the link loses frames"):
        arrivals_ms(400, "loss=5%", seed=1)


def test_the_report_compares_the_two_choices() -> None:
    scores = made_up()
    assert [least_in_phase(scores, "here", name)[0] for name in PREDICTORS] == [40, 40, 0]
    assert advice(scores, "here") == (
        "Over here: with a buffer of 20 ms, the pulse of that long ago is felt with an error of"
        " 0.2 mN; its error in phase is 45.0 mN (1.50 JND). With the stack predicting all, on"
        " average 44 ms ahead, the error in phase is 10.0 mN (0.33 JND)."
    )
    table = report_links(scores, LITTLE).chapters[0].tables[0]
    assert [row[:3] for row in table.rows[-2:]] == [
        ("here", "stack", "0"),
        ("here", "stack", "auto: 20.0"),
    ]
