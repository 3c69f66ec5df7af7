import os
import time
from dataclasses import replace
from pathlib import Path

import pytest

from protocol.errors import SweepError
from protocol.host.child_process import ChildProcess
from telepulse.processes import cpu_time_s
from telepulse.reports.studies import cost_scores
from telepulse.reports.studies.cost_report import report_costs, verdict, works
from telepulse.reports.studies.cost_scores import (
    CostEffort,
    CostScores,
    Settings,
    pareto_front,
    score_costs,
    shipped,
    simulate_cost,
)
from telepulse.scene import load_scene
from tests.support.netem import cpu_quota
from tests.support.nodes import known
from tests.support.tcp import needs_emulator

LITTLE = CostEffort(
    ticks_ms=(4.0,),
    predictors=("hold",),
    delays_ms=(None,),
    batches_ms=(20.0,),
    paths=(1,),
    seconds=2,
    settle_seconds=1,
    live_seconds=0,
    slow=((4.0, "hold", 20.0),),
)
no_quota = cpu_quota.unavailable()
QUOTA_S = 2.0


def test_the_front_has_the_points_that_no_other_dominates() -> None:
    points = [(1.0, 9.0), (9.0, 1.0), (5.0, 5.0), (5.0, 6.0), (9.0, 9.0), (1.0, 9.0)]
    assert pareto_front(points, equal=0.0) == [True, True, True, False, False, True]
    # Differences below the share count as none: neither of two dominates the other.
    assert pareto_front([(100.0, 100.0), (95.0, 104.0)], equal=0.1) == [True, True]
    assert pareto_front([(100.0, 100.0), (105.0, 80.0)], equal=0.1) == [False, True]
    assert pareto_front([]) == []


def test_the_shipped_settings_are_those_of_the_default_scene_and_every_case_can_be_loaded(
    tmp_path: Path,
) -> None:
    assert shipped() == Settings(2.0, "stack", None, 5.0, 1)
    effort = CostEffort()
    cases = [*effort.combinations(), *effort.variations()]
    assert effort.combinations()[0] == effort.variations()[0] == shipped()
    path = tmp_path / "scene.toml"
    for case in cases:
        path.write_text(case.toml(), encoding="utf-8")
        scene = load_scene(path)
        display, delay_ns = scene.display, scene.display.compensation_ns
        assert display.tick_ns == case.tick_ms * 1e6
        assert (display.predictor.kind, display.paths) == (case.predictor, case.paths)
        assert delay_ns == (None if case.delay_ms is None else case.delay_ms * 1e6)
        assert scene.sensing.batch_ns == case.batch_ms * 1e6


def test_shorter_frames_and_more_paths_are_packets_and_a_longer_tick_is_less_load() -> None:
    effort = replace(LITTLE, seconds=3)
    base = shipped()._replace(predictor="hold", paths=1)
    one, triple = (simulate_cost(base._replace(paths=paths), effort) for paths in (1, 3))
    seldom = simulate_cost(base._replace(tick_ms=4.0, batch_ms=20.0), effort)
    assert one.frames_per_s == pytest.approx(200, rel=0.02)
    assert triple.frames_per_s == pytest.approx(600, rel=0.05)
    assert seldom.frames_per_s == pytest.approx(50, rel=0.02)
    assert seldom.load < one.load
    assert 0 < one.p50_us <= one.p99_us
    # With hold and E = auto the pulse is played late.
    assert one.in_phase_n > 10 * one.aligned_n


def test_a_report_without_processes_says_why_and_a_case_that_fails_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scores = score_costs(LITTLE)
    report = report_costs(scores, LITTLE)
    front, live, slow = report.chapters
    assert list(front.findings) == [verdict(scores)]
    marks = [row[-1] for row in front.tables[1].rows]
    assert sum("shipped" in mark for mark in marks) == 1
    assert {mark for mark in marks if mark} == {row[-1] for row in front.tables[0].rows}
    assert live.tables == slow.tables == ()
    assert live.paragraphs[0].startswith("Left out: ")
    with pytest.raises(SweepError, match="nowhere"):
        score_costs(LITTLE, "nowhere")


def test_the_verdict_names_what_dominates_the_shipped_settings() -> None:
    cost = cost_scores.SimulatedCost(0.05, 0.01, 40.0, 50.0, 90.0, 0.1, 200.0)
    other = shipped()._replace(tick_ms=4.0)
    scores = CostScores({shipped(): cost, other: cost._replace(load=0.05)}, {}, "", {}, "", 0.0)
    assert verdict(scores).endswith(f"dominated by 1: {other}.")
    scores.simulated[other] = cost._replace(load=0.05, in_phase_n=0.06)
    assert verdict(scores).endswith("on the front.")


@pytest.mark.skipif(no_quota is not None, reason=str(no_quota))
def test_a_limited_process_gets_its_share_of_a_core_and_is_in_its_own_group_afterwards() -> None:
    with ChildProcess("busy process", "-c", "while True: pass") as busy:
        membership = Path(f"/proc/{busy.pid}/cgroup")
        before = membership.read_text(encoding="ascii")
        os.sched_setscheduler(busy.pid, os.SCHED_RR, os.sched_param(1))
        with cpu_quota.limited([busy.pid], 0.1):
            assert f"telepulse-{os.getpid()}-{busy.pid}" in membership.read_text("ascii")
            before_s, began_s = cpu_time_s(busy.pid), time.monotonic()
            time.sleep(QUOTA_S)
            limited_s, took_s = cpu_time_s(busy.pid) - before_s, time.monotonic() - began_s
        assert membership.read_text(encoding="ascii") == before
    assert 0 < limited_s < 0.15 * took_s


@needs_emulator
def test_both_nodes_are_measured_as_processes() -> None:
    settings = shipped()._replace(tick_ms=4.0, predictor="hold", batch_ms=20.0)
    run = cost_scores.run_live(settings, seconds=7)
    assert 0 < known(run.sensing_cpu) < 1
    assert 0 < known(run.display_cpu) < 2
    carried = known(run.carried)
    assert carried.bytes > 60 * carried.packets > 0
    assert isinstance(works(run), bool)
