"""Lines of a log: what a trial's intervals say of it."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest

from telepulse.experiment.interval import Interval, IntervalPlayback, PlayedInterval, draw_interval
from telepulse.experiment.log import AnsweredTrial
from telepulse.experiment.session import SessionPlan, Trial, draw_trials
from tests.support.experiment_sessions import condition, plan, played

TRIAL = Trial(condition="plain", direct="A", x="B", pulse_seed=1)
CLEAN = [played("A", False, 1e-3), played("B", True, 50e-3), played("X", True, 50e-3)]


@pytest.mark.parametrize(
    ("spoils", "why"),
    [
        ({"ticks": 1000, "deadline_misses": 30}, "3.0 % of the ticks missed"),
        ({"ticks": 1000, "stale_ticks": 60}, "the stream stale for 6.0 % of the ticks"),
        ({"ticks": 1000, "felt_s": 0.0}, "never felt at full strength"),
        ({"ticks": 10_000, "deadline_misses": 59, "longest_gap_ms": 60.0}, "no tick for 60 ms"),
    ],
)
def test_a_spoilt_trial_is_named_in_its_line(spoils: dict[str, float], why: str) -> None:
    # A is direct.
    spoilt = [CLEAN[0].model_copy(update=spoils), *CLEAN[1:]]
    assert AnsweredTrial.of(0, TRIAL, "A", spoilt).spoilt == why
    few = [*CLEAN[:2], CLEAN[2].model_copy(update={"ticks": 1000, "deadline_misses": 9})]
    assert AnsweredTrial.of(0, TRIAL, "A", few).spoilt == ""


def test_a_line_has_what_follows_from_its_trial_and_intervals() -> None:
    right = AnsweredTrial.of(3, TRIAL, "B", CLEAN, 2.5)
    assert (right.index, right.condition, right.correct, right.response_s) == (
        3,
        "plain",
        True,
        2.5,
    )
    errors = (right.error_a, right.error_b, right.error_x)
    assert errors == pytest.approx((1e-3 / 0.3, 50e-3 / 0.3, 50e-3 / 0.3))
    assert AnsweredTrial.of(3, TRIAL, "A", CLEAN).correct is False
    catch = TRIAL.model_copy(update={"condition": None})
    assert AnsweredTrial.of(3, catch, "A", CLEAN).correct is None
    rated = AnsweredTrial.of(3, TRIAL, 4, [CLEAN[0], CLEAN[2]])
    assert (rated.correct, rated.error_b) == (None, None)


def test_a_stream_that_its_own_link_leaves_stale_is_named_and_counted(tmp_path: Path) -> None:
    whole = plan(tmp_path, condition("plain", "delay=5ms", "auto"), interval="0.5 s")
    cut = plan(tmp_path, condition("plain", "delay=5ms,cut.from=2s,cut.for=3s", "auto"))

    def felt(found: SessionPlan, stall_ms: int = 0) -> PlayedInterval:
        trial = draw_trials(found.session, 1)[0]
        letter: Literal["A", "B"] = "B" if trial.direct == "A" else "A"
        drawn: Interval = replace(
            draw_interval(found, 1, 0, trial, letter, 1),
            foreperiod_ns=1_700_000_000,
            felt_ns=700_000_000,
        )
        playing, now_ns, elapsed = IntervalPlayback(drawn, 0), 0, 1
        while playing.tick(now_ns, elapsed):
            # The machine stalls once, in the middle of the felt time.
            elapsed = 1 + (stall_ms if now_ns == 2_000_000_000 else 0)
            now_ns += elapsed * drawn.scene.display.tick_ns
        return playing.played()

    undisturbed = felt(whole)
    assert undisturbed.stale == undisturbed.spoilt == ""
    # A stall of the machine does not count as a stale link.
    stalled = felt(whole, stall_ms=300)
    assert stalled.stale_ticks == 0
    assert "of the ticks missed" in stalled.spoilt
    broken = felt(cut)
    assert broken.stale_ticks > 0
    assert "stale" in broken.stale
    assert broken.spoilt == ""
    assert "stale" in broken.model_copy(update={"on_link": False}).spoilt
    line = AnsweredTrial.of(0, TRIAL, "A", [*CLEAN[:2], broken.model_copy(update={"letter": "X"})])
    assert (line.stale, line.spoilt) == (True, "")
