import dataclasses
from pathlib import Path

import pytest

from protocol.errors import SceneError
from protocol.summary.phrases import limit_texts
from protocol.summary.tables import Summary
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation, summarise
from tests.support.nodes import RADIAL, ROOT, assert_accounted, known

SCENES = sorted((ROOT / "scenes").glob("*.toml"))
LIVE = [p for p in SCENES if p.stem.endswith("_bench") and p.stem != "real_bench"]
LIVE += [path for path in SCENES if path.stem == "real_press"]
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
    summary = summarise(load_scene(path), seconds=8, seed=1)
    accounted(summary)
    for figures in summary.of_each_contactor().values():
        assert limit_texts(dataclasses.asdict(figures.limited)) == []
        assert figures.within_jnd == 1.0
    assert summary.faults == []
    assert summary.rejected == {}


@pytest.mark.parametrize("path", LIVE, ids=lambda path: path.stem)
def test_a_scene_of_a_live_bench_is_not_simulated(path: Path) -> None:
    with pytest.raises(SceneError, match='kind "serial" is a live sensor'):
        summarise(load_scene(path), seconds=1, seed=1)


def test_over_a_perfect_link_every_sample_is_played() -> None:
    summary = summarise(load_scene(RADIAL, BUFFERED), seconds=10, seed=1)
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
    summary = summarise(with_link("delay=40ms,jitter=10ms"), seconds=60, seed=1)
    accounted(summary)
    assert summary.samples.lost == 0
    assert summary.frames.reordered
    assert 0 < known(summary.samples.late) / 60_000 < 0.02
    assert summary.within_jnd == 1.0


def test_the_offset_of_a_sensing_clock_an_hour_ahead_is_found() -> None:
    simulation = Simulation(with_link("delay=25ms"), seed=1)
    summary = simulation.run(5)
    clock = simulation.display.summary().clock
    assert clock.offset_ms == pytest.approx(3_600_000, abs=1e-3)
    assert summary.one_way_delay_ms.p50 == pytest.approx(25, abs=0.1)
    assert summary.clock.offset_ms == pytest.approx(0.0, abs=1e-3)


def test_a_total_loss_ends_with_nothing_played() -> None:
    summary = summarise(with_link("loss=100%"), seconds=3, seed=1)
    assert summary.samples.played == 0
    assert summary.samples.before_joining == 3000
    assert summary.force_rmse_n.aligned is None


def test_a_pulse_above_the_force_limit_is_counted_as_cut(tmp_path: Path) -> None:
    path = tmp_path / "hard.toml"
    text = RADIAL.read_text(encoding="utf-8")
    path.write_text(text.replace('peak_to_peak = "0.3 N"', 'peak_to_peak = "6 N"'), "utf-8")
    limited = summarise(load_scene(path), seconds=8, seed=1).limited
    # Each of ten beats is limited at its peak, and once or twice below 0 N between the peaks.
    for limit in (limited.force, limited.negative):
        assert 7 <= known(limit.times) <= 20
        assert limit.share == pytest.approx(known(limit.seconds) / 9.5, rel=0.1)
    assert known(limited.travel.times) > 0


def play(text: str) -> Summary:
    return summarise(with_link("delay=20ms," + text), SECONDS, seed=1)


def late_and_lost(summary: Summary) -> tuple[int, int]:
    """Return late and lost samples of a run in which every sample is accounted for."""
    samples = summary.samples
    assert accounted(summary) == SAMPLES
    assert samples.before_joining == 0
    assert summary.rejected == {}
    assert summary.faults == []
    return samples.late or 0, samples.lost or 0


@pytest.mark.parametrize(
    ("text", "late", "lost"),
    [
        ("", False, False),
        ("jitter=5ms", True, False),
        ("jitter=5ms,jitter_kind=pareto", True, False),
        ("jitter=5ms,jitter_kind=bursts", True, False),
        ("loss=2%", False, True),
        ("burst_loss.share=2%,burst_loss.length=50ms", False, True),
        ("reorder.share=0.5%,reorder.by=30ms", True, False),
        ("rate=1Mbit/s", False, False),
        ("route_change.at=4s,route_change.by=30ms", True, False),
        ("cut.from=4s,cut.for=1s", False, True),
    ],
)
@pytest.mark.parametrize("transport", ["datagram", "tcp"])
def test_each_impairment_makes_samples_late_or_lost(
    text: str, late: bool, lost: bool, transport: str
) -> None:
    summary = play(f"{text},transport={transport}")
    samples_late, samples_lost = late_and_lost(summary)
    if transport == "tcp":
        # Lost packets are repeated and come late; none overtakes another.
        late, lost = late or lost, False
        assert summary.frames.reordered == 0
    assert (samples_late > 0, samples_lost > 0) == (late, lost)


def test_a_rate_below_the_streams_loses_datagrams_and_the_rest_waits_in_the_queue() -> None:
    summary = play("rate=100kbit/s")
    _, lost = late_and_lost(summary)
    assert lost > SAMPLES / 4
    assert summary.one_way_delay_ms.p50 is not None
    # The true delay is at most 20 + 200 ms plus 9 ms for a frame. Only one direction has a queue,
    # part of which clock exchanges take for an offset.
    assert 120 < summary.one_way_delay_ms.p50 < 229


def test_a_cut_loses_as_much_as_was_sent_meanwhile() -> None:
    assert late_and_lost(play("cut.from=4s,cut.for=1s"))[1] == 1000
    summary = play("cut.from=4s,cut.for=1s,transport=tcp")
    assert summary.one_way_delay_ms.max == pytest.approx(1000 + 20 + 55, abs=10)


def test_over_tcp_the_paths_of_the_scene_are_modelled() -> None:
    lossy = with_link("delay=20ms,jitter=3ms,loss=1%,transport=tcp")
    played = {}
    for paths in (1, 3):
        display = lossy.display.model_copy(update={"paths": paths})
        played[paths] = summarise(dataclasses.replace(lossy, display=display), SECONDS, seed=1)
        assert accounted(played[paths]) == SAMPLES
        assert played[paths].rejected == {}
    single, triple = played.values()
    assert [summary.data_connections.open for summary in played.values()] == [1, 3]
    assert known(single.frames.copies) == 0
    assert known(triple.frames.copies) > 0
    assert known(triple.one_way_delay_ms.p99) < known(single.one_way_delay_ms.p99) / 2
