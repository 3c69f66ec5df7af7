"""The pulse against hold-down on the page, during a sweep."""

import numpy as np
import pytest

from display_node.press.sweep import SweepPlan
from telepulse.view.live import LiveState
from telepulse.view.text import figures
from telepulse.view.window_data import hidden_plots, window_data, window_scores
from tests.support.recorded_sweeps import SweptWrist
from tests.unit.telepulse.view.page_states import SECOND_NS, SimulatedDisplay, play_sweep

WINDOW_NS = 5 * SECOND_NS
ONLY_PRESSED = {"press", "depth", "shape"}


def test_the_page_shows_curve_and_levels_of_a_sweep_as_its_report_does() -> None:
    plan = SweepPlan(low_n=0.4, high_n=2.0, steps=6, beats=3)
    display, wrist = SimulatedDisplay(LiveState()), SweptWrist(plan)
    assert set(hidden_plots(display.live)) == ONLY_PRESSED
    play_sweep(display, wrist, 1.2)
    data = window_data(display.live, WINDOW_NS)
    assert hidden_plots(display.live) == ["error"]
    curve = display.live.depth.curve
    assert curve is not None
    best_n = wrist.artery.best_n
    assert curve.best_n.value == pytest.approx(best_n, rel=0.03)
    assert data.columns["deeper"]["t"].tolist() == [curve.best_n.value] * 2
    for name in ("light", "deepest"):
        top_mn = data.columns[name]["y"].max()
        assert top_mn == pytest.approx(0.5e3 * curve.largest_n.value, rel=0.02)
    beats = data.columns["depth_beats"]
    heights_mn = [1e3 * wrist.artery.height_n(force_n) for force_n in beats["t"]]
    assert len(heights_mn) > 20
    assert beats["y"] == pytest.approx(heights_mn, rel=0.1, abs=3)
    # The artery is closed between beats beyond the best hold-down.
    flat, deep = data.columns["shape_flat"], data.columns["shape_flat"]["t"] > 1.3 * best_n
    assert np.median(flat["y"][deep]) > 1.5 * np.median(flat["y"][~deep])
    shown = figures(display.live, window_scores(display.live, WINDOW_NS))
    assert shown["press"] == ("finger 1.20 N", "wrist 1.20 N, loop gain 0.0002, probe pressing")
    assert shown["levels"].value == f"best {curve.best_n.value:.2f} N"
    assert shown["aligned"].value == "–"
    # Another run has beats of its own.
    display.event("begin", "another run of the display")
    assert window_data(display.live, WINDOW_NS).columns["depth_beats"]["t"].size == 0
