import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from display_node.verdict import verdict
from protocol.summary.fields import Summary
from protocol.summary.phrases import limit_texts
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.simulated_run import simulate
from telepulse.simulation.virtual_time import Simulation
from tests.support.nodes import RADIAL, ROOT, assert_accounted, known

SCENES = sorted((ROOT / "scenes").glob("*.toml"))
LIVE = [p for p in SCENES if p.stem.endswith("_bench") and p.stem != "real_bench"]
LIVE += [path for path in SCENES if path.stem in ("class_wrist", "real_press")]
# Where the finger presses, the felt pulse depends on its press: test_press_bars.py.
PRESSED = ("press", "press_far")
MODELLED = [path for path in SCENES if path not in LIVE and path.stem not in PRESSED]
SECONDS = 8
SAMPLES = 1000 * SECONDS


# Without a predictor that learns, E is what the buffer requires.
BUFFERED = {"predictor": "linear"}


def with_link(text: str, path: Path = RADIAL) -> Scene:
    return dataclasses.replace(load_scene(path, BUFFERED), link=parse_link(text))


def accounted(summary: Summary) -> int:
    assert_accounted(dataclasses.asdict(summary.samples))
    return known(summary.samples.sent)


@pytest.mark.parametrize("path", MODELLED, ids=lambda path: path.stem)
def test_the_pulse_of_every_modelled_scene_is_felt_within_the_jnd_and_its_limits(
    path: Path,
) -> None:
    scene = load_scene(path)
    summary = Simulation(scene, 1).run(8)
    accounted(summary)
    for figures in summary.of_each_contactor().values():
        assert limit_texts(dataclasses.asdict(figures.limited)) == []
        assert known(figures.within_jnd) >= 1 - scene.display.noticed_target
    assert summary.faults == []
    assert summary.rejected == {}


def test_over_a_perfect_link_every_sample_is_played() -> None:
    summary = Simulation(load_scene(RADIAL, BUFFERED), 1).run(10)
    assert accounted(summary) == summary.samples.played == 10_000
    # The error of the nearest microstep alone is 0.18 mN.
    assert summary.force_rmse_n.aligned == pytest.approx(0.18e-3, rel=0.1)
    assert summary.one_way_delay_ms.max == 0


def test_the_display_counts_the_samples_that_the_link_lost() -> None:
    simulation = Simulation(with_link("delay=30ms,loss=5%"), seed=3)
    summary = simulation.run(20)
    accounted(summary)
    assert simulation.lost_frames > 100
    assert summary.samples.lost == 5 * simulation.lost_frames
    assert summary.samples.late == 0


def test_jitter_makes_disorder_and_at_most_the_target_share_of_late_samples() -> None:
    summary = Simulation(with_link("delay=40ms,jitter=10ms"), 1).run(60)
    accounted(summary)
    assert summary.samples.lost == 0
    assert summary.frames.reordered
    assert 0 < known(summary.samples.late) / 60_000 < 0.02
    assert summary.within_jnd == 1.0


def test_a_total_loss_ends_with_nothing_played() -> None:
    summary = Simulation(with_link("loss=100%"), 1).run(3)
    assert summary.samples.played == 0
    assert summary.samples.before_joining == 3000
    assert summary.force_rmse_n.aligned is None


def test_a_pulse_above_the_force_limit_is_counted_as_cut(tmp_path: Path) -> None:
    path = tmp_path / "hard.toml"
    text = RADIAL.read_text(encoding="utf-8")
    path.write_text(text.replace('peak_to_peak = "0.3 N"', 'peak_to_peak = "6 N"'), "utf-8")
    limited = Simulation(load_scene(path), 1).run(8).limited
    # Each of ten beats is limited at its peak, and once or twice below 0 N between the peaks.
    for limit in (limited.force, limited.negative):
        assert 7 <= known(limit.times) <= 20
        assert limit.share == pytest.approx(known(limit.seconds) / 9.5, rel=0.1)
    assert known(limited.travel.times) > 0


def test_over_tcp_the_paths_of_the_scene_are_modelled() -> None:
    lossy = with_link("delay=20ms,jitter=3ms,loss=1%,transport=tcp")
    played = {}
    for paths in (1, 3):
        display = lossy.display.model_copy(update={"paths": paths})
        played[paths] = Simulation(dataclasses.replace(lossy, display=display), 1).run(SECONDS)
        assert accounted(played[paths]) == SAMPLES
        assert played[paths].rejected == {}
    single, triple = played.values()
    assert [summary.data_connections.open for summary in played.values()] == [1, 3]
    assert known(single.frames.copies) == 0
    assert known(triple.frames.copies) > 0
    assert known(triple.one_way_delay_ms.p99) < known(single.one_way_delay_ms.p99) / 2


@pytest.mark.parametrize("modulus", ["0.05 GPa", "0.025 GPa"], ids=["same layer", "softer layer"])
def test_the_error_is_told_as_a_share_of_the_pulse_that_reaches_the_finger(modulus: str) -> None:
    layer = {"thickness": "2 mm", "poisson_ratio": 0.5, "young_modulus": modulus}
    held = {"predictor": "hold", "compensation": "0 s", "layer": layer}
    run = simulate("radial", 10, display=held, link="delay=20ms")
    pulse_n = run.first.force_ratio * (np.nanmax(run.wrist_n) - np.nanmin(run.wrist_n))
    share = known(run.summary.force_rmse_n.aligned) / pulse_n
    (text,) = (line for line in verdict(run.summary).lines if "of the pulse's height" in line)
    told = re.search(r"([\d.]+) % of the pulse's height", text)
    assert told is not None
    assert float(told[1]) == pytest.approx(100 * share, rel=0.15)
