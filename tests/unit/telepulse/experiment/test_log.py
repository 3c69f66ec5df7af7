"""Answers that are never pooled silently: of simulated observers, other sessions, spoilt trials."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from typer.testing import CliRunner

from telepulse.cli.main import app
from telepulse.experiment.interval import Interval, IntervalPlayback, PlayedInterval, draw_interval
from telepulse.experiment.log import AnsweredTrial, LogError, SessionHeader, SessionLog, gather, now
from telepulse.experiment.report import build_report
from telepulse.experiment.session import SessionPlan, draw_trials
from tests.support.experiment_sessions import condition, plan, played, write

CLEAN = [played("A", False, 1e-3), played("B", True, 50e-3), played("X", True, 50e-3)]


def log(
    found: SessionPlan,
    name: str,
    intervals: list[list[PlayedInterval]],
    threshold: float | None = None,
    felt_on: Literal["drive", "models"] = "drive",
) -> SessionLog:
    header = SessionHeader(
        version="0.1.0",
        time=now(),
        tables=found.tables,
        seed=1,
        threshold=threshold,
        trials=draw_trials(found.session, 1),
        felt_on=felt_on,
    )
    answered = tuple(
        AnsweredTrial(time=now(), index=index, answer="A", response_s=None, played=tuple(felt))
        for index, felt in enumerate(intervals)
    )
    return SessionLog(Path(f"{name}.jsonl"), header, found.session, answered, 0)


def test_people_and_simulated_observers_are_reported_apart(tmp_path: Path) -> None:
    found = plan(tmp_path, condition("plain"))
    person, observer = log(found, "anna", [CLEAN]), log(found, "o", [CLEAN], 0.05, "models")
    models = log(found, "bo", [CLEAN], felt_on="models")
    with pytest.raises(LogError, match=r"by a simulated observer.*by a person"):
        gather([person, observer])
    with pytest.raises(LogError, match="on the scene's models"):
        gather([person, models])
    text = " ".join(build_report([observer]).chapters[0].findings)
    assert "Simulated" in text
    assert "threshold 5 %" in text
    assert text.startswith("One simulated observer identified X in ")
    # A terminal shows only tables.
    assert any("Simulated" in finding for finding in build_report([observer]).findings)
    assert "Nobody felt" in " ".join(build_report([models]).chapters[0].findings)
    assert "imulated" not in " ".join(build_report([person]).chapters[0].findings)


def test_the_result_comes_first_with_its_interval_and_its_p_value(tmp_path: Path) -> None:
    report = build_report([log(plan(tmp_path, condition("plain")), "anna", [CLEAN] * 2)])
    first = report.findings[0]
    right = re.match(r"One subject identified X in (\d) of 2 trials, ", first)
    assert right is not None
    probability = sum(math.comb(2, hits) for hits in range(int(right[1]), 3)) / 4
    assert "95 % Clopper–Pearson confidence interval" in first
    assert (
        f"By guessing, as many or more are right with a probability of {probability:.3f}" in first
    )
    assert len(report.findings) <= 5
    assert "true share is" not in str(report.to_dict())
    assert "over 0.0" not in str(report.to_dict())


def test_other_sessions_and_scenes_are_reported_apart(tmp_path: Path) -> None:
    first = log(plan(tmp_path, condition("plain")), "a", [CLEAN])
    longer = log(plan(tmp_path, condition("plain"), interval="2 s"), "b", [CLEAN])
    elsewhere = log(plan(tmp_path, condition("plain"), scene="bench"), "c", [CLEAN])
    more = log(plan(tmp_path, condition("plain"), trials=5, seed=9), "d", [CLEAN])
    with pytest.raises(LogError, match="another interval_ns"):
        gather([first, longer])
    with pytest.raises(LogError, match="another scene"):
        gather([first, elsewhere])
    assert len(gather([first, more]).outcomes) == 2


@pytest.mark.parametrize(
    ("spoils", "why"),
    [
        ({"ticks": 1000, "deadline_misses": 30}, "3.0 % of the ticks missed"),
        ({"ticks": 1000, "stale_ticks": 60}, "the stream stale for 6.0 % of the ticks"),
        ({"ticks": 1000, "felt_s": 0.0}, "never felt at full strength"),
        ({"ticks": 10_000, "deadline_misses": 59, "longest_gap_ms": 60.0}, "no tick for 60 ms"),
        # Logs of older versions have no ticks; this interval is 1 s.
        ({"deadline_misses": 30}, "3.0 % of the ticks missed"),
    ],
)
def test_a_spoilt_trial_is_named_and_left_out_unless_asked_for(
    spoils: dict[str, float], why: str, tmp_path: Path
) -> None:
    found = plan(tmp_path, condition("plain"))
    # A is direct.
    spoilt = [CLEAN[0].model_copy(update=spoils), *CLEAN[1:]]
    made = log(found, "anna", [CLEAN, spoilt])
    results = gather([made])
    assert (len(results.outcomes), len(results.spoilt), results.pooled) == (1, 1, False)
    chapter = build_report([made]).chapters[0]
    assert any("1 answered trial is spoilt" in text for text in chapter.findings)
    (table,) = [table for table in chapter.tables if table.title == "Spoilt trials"]
    assert table.rows == [("anna", "2", "plain", why)]
    assert len(gather([made], with_spoilt=True).outcomes) == 2
    alone = gather([log(found, "bo", [spoilt])])
    assert (len(alone.outcomes), alone.pooled) == (1, True)
    few = [*CLEAN[:2], CLEAN[2].model_copy(update={"ticks": 1000, "deadline_misses": 9})]
    assert gather([log(found, "cy", [few])]).spoilt == ()


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
    made = log(cut, "anna", [[*CLEAN[:2], broken.model_copy(update={"letter": "X"})]])
    assert gather([made]).spoilt == ()
    text = " ".join(build_report([made]).chapters[0].findings)
    assert "an effect of the condition: plain: 1." in text


def test_a_scene_without_a_drive_is_refused_for_a_person(tmp_path: Path) -> None:
    session, out = write(tmp_path / "s.toml"), tmp_path / "log.jsonl"
    result = CliRunner().invoke(app, ["experiment", "run", str(session), "--log", str(out)])
    assert result.exit_code == 2
    assert "has no [display.drive]" in result.stderr
    assert "--without-drive" in result.stderr
    assert not out.exists()
