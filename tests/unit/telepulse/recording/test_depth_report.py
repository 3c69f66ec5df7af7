"""Reports of sweeps: they say that a wrist is modelled, and how well a force is known."""

import numpy as np
import pytest

from display_node.press.sweep import SweptLevel
from display_node.scoring.depth_curve import BeatPoint, DepthCurve, Estimate
from telepulse.recording.depth_report import report_depth

POINTS = [BeatPoint(1.2, 0.3, 0.4, 0.1, 0.4, 0.3, 1.0)] * 5


def curve(best_n: float = 1.2) -> DepthCurve:
    force_n = np.linspace(0.2, 2.0, 50)
    height_n = 0.3 * np.exp(-(((force_n - best_n) / 0.4) ** 2))
    estimates = Estimate(best_n, 0.002), Estimate(0.3, 0.001), Estimate(best_n - 0.3, 1e-5)
    return DepthCurve(POINTS, force_n, height_n, 0 * force_n, *estimates, Estimate(1.5, 0.02))


@pytest.mark.parametrize(("modelled", "wrist"), [(True, "modelled wrist"), (False, "wrist")])
def test_a_sweep_names_what_was_pressed(modelled: bool, wrist: str) -> None:
    levels = [SweptLevel(1.2, 1.2, POINTS)]
    report = report_depth(curve(), levels, (), "press", modelled)
    assert report.findings[0].startswith(f"The pulse of the {wrist} is highest, 300 mN, at")
    assert f"this {wrist}'s curve" in report.chapters[0].tables[0].note
    assert ("modelled" in report.title) == modelled
    assert "person" not in str(report.to_dict())


def test_a_deviation_is_shown_to_the_digit_in_which_it_is_not_nought() -> None:
    rows = report_depth(curve(), [SweptLevel(1.2, 1.2, POINTS)], (), "press", True).chapters[0]
    forces = [row[1] for row in rows.tables[0].rows]
    assert forces == ["0.900 (± below 0.001)", "1.200 ± 0.002", "1.50 ± 0.02"]
