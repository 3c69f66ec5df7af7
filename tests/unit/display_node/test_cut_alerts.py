"""Alerts and figures of a display whose stream is cut: nothing is wrong with the sensor."""

from dataclasses import replace

import pytest

from display_node.telemetry.alerts import AlertKind, alerts
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation

# Statuses are 0.4 s apart.
STATUS_NS = 400_000_000
CUT_S, SECONDS = 12.0, 26.0


@pytest.mark.parametrize("cut_s", [1.0, 3.0, 6.0])
def test_a_cut_is_no_alert_of_the_pulse_and_its_figures_begin_anew(cut_s: float) -> None:
    scene = load_scene(find_scene("radial"))
    scene = replace(scene, link=parse_link(f"delay=5ms,cut.from={CUT_S}s,cut.for={cut_s}s"))
    run, found, rates_after = Simulation(scene, 1), set[AlertKind](), list[float | None]()
    for state in run.ticks(SECONDS):
        if state.now_ns % STATUS_NS:
            continue
        summary = run.display.summary()
        found |= {alert.kind for alert in alerts(run.display.state, summary.to_dict())}
        if state.now_ns * 1e-9 > CUT_S + cut_s + 0.4:
            rates_after.append(summary.beats.rate_per_min)
    assert AlertKind.STALE in found
    assert AlertKind.PULSE not in found
    assert rates_after[0] is None
    assert rates_after[-1] == pytest.approx(75, rel=0.05)
