"""A stream with an ECG is predicted with it, unless the scene or the predictor uses none."""

from pathlib import Path

import pytest

from protocol.summary.tables import AnnounceFigures, Summary
from telepulse.scene import load_scene
from telepulse.simulation.virtual_time import summarise

ROOT = Path(__file__).parents[3]
SECONDS = 16.0
# `make test` has the predictor's own test, and that of the scene.
pytestmark = pytest.mark.system


def run(tmp_path: Path, text: str, base: str = "announce") -> Summary:
    path = tmp_path / "scene.toml"
    path.write_text(f'extends = "{ROOT / "scenes" / base}.toml"\n{text}', encoding="utf-8")
    return summarise(load_scene(path), SECONDS, seed=1)


def test_r_waves_of_the_stream_are_used_and_counted(tmp_path: Path) -> None:
    figures = run(tmp_path, "").announce
    assert figures.r_waves == pytest.approx(SECONDS * 75 / 60, abs=4)
    assert figures.used is not None
    assert figures.used > 0.3
    assert figures.unused is None
    assert figures.transit_ms == pytest.approx(240, abs=15)
    assert figures.deviation_ms is not None
    assert figures.deviation_ms < 15


def test_a_scene_can_leave_the_ecg_unused(tmp_path: Path) -> None:
    summary = run(tmp_path, '[display]\nannounce = "off"')
    assert summary.announce == AnnounceFigures()
    assert summary.beats.count is not None
