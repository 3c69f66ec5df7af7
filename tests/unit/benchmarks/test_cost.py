"""The Pareto front of the settings, and the scenes of the cases."""

from pathlib import Path

from benchmarks.cost.runs import Effort, pareto_front, shipped
from telepulse.scene import load_scene


def test_the_front_has_the_points_that_no_other_dominates() -> None:
    points = [(1.0, 9.0), (9.0, 1.0), (5.0, 5.0), (5.0, 6.0), (9.0, 9.0), (1.0, 9.0)]
    assert pareto_front(points, equal=0.0) == [True, True, True, False, False, True]
    # Differences below the share count as none: neither of two dominates the other.
    assert pareto_front([(100.0, 100.0), (95.0, 104.0)], equal=0.1) == [True, True]
    assert pareto_front([(100.0, 100.0), (105.0, 80.0)], equal=0.1) == [False, True]
    assert pareto_front([]) == []


def test_every_case_has_its_settings(
    tmp_path: Path,
) -> None:
    effort = Effort()
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
