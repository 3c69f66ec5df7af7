"""A stream with an ECG is predicted with it, unless the scene uses none."""

import pytest

from protocol.config.scene_file import find_scene
from protocol.summary.fields import AnnounceFigures
from telepulse.scene import load_scene
from telepulse.simulation.virtual_time import Simulation

SECONDS = 16.0
# `make test` has the predictor's own test, and that of the scene.
pytestmark = pytest.mark.system


def test_r_waves_of_the_stream_are_used_and_counted() -> None:
    figures = Simulation(load_scene(find_scene("announce")), 1).run(SECONDS).announce
    assert figures.r_waves == pytest.approx(SECONDS * 75 / 60, abs=4)
    assert figures.used is not None
    assert figures.used > 0.3
    assert figures.unused is None
    assert figures.transit_ms == pytest.approx(240, abs=15)
    assert figures.deviation_ms is not None
    assert figures.deviation_ms < 15


def test_a_scene_can_leave_the_ecg_unused() -> None:
    scene = load_scene(find_scene("announce"), {"announce": "off"})
    assert Simulation(scene, 1).run(SECONDS).announce == AnnounceFigures()
