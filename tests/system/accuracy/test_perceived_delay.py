"""Buffering or prediction over links with delay, jitter and stalls."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.prediction import PredictorName
from display_node.prediction.scene import own_predictor
from protocol.summary.fields import Summary
from protocol.ticks import TickState
from sensing_node.sources.recorded import RecordingScene
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation
from tests.support.drawn_pulses import Floats, drawn, fibrillating, make_rhythm
from tests.support.nodes import RADIAL, known

MS = 1_000_000
STREAM_BEGINS_S = 0.5
WAN = "delay=40ms,jitter=5ms,loss=1%"
STALLS = "delay=40ms,loss=1%,transport=tcp"
CALM_S, TROUBLED_S = 26.0, 8.0


def scene(
    link: str,
    predictor: PredictorName,
    compensation_ms: int | None = None,
    batch_ms: int = 5,
    pulse_n: Floats | None = None,
    folder: Path | None = None,
) -> Scene:
    """Return `radial` with a tick of 1 ms; compensation_ms: None for auto; pulse_n: at 1 kHz."""
    radial = load_scene(RADIAL)
    sensing = radial.sensing.model_copy(update={"batch_ns": batch_ms * MS})
    if pulse_n is not None:
        assert folder is not None
        np.save(folder / "pulse.npy", pulse_n)
        table = {"path": str(folder / "pulse.npy"), "rate": "1 kHz", "unit": "N", "repeat": "once"}
        source = RecordingScene.model_validate({"kind": "recording", **table})
        sensing = sensing.model_copy(update={"source": source})
    compensation_ns = "auto" if compensation_ms is None else compensation_ms * MS
    changes = {
        "predictor": own_predictor(predictor),
        "compensation_ns": compensation_ns,
        "tick_ns": MS,
    }
    display = radial.display.model_copy(update=changes)
    return dataclasses.replace(radial, sensing=sensing, display=display, link=parse_link(link))


def played(scene: Scene, seconds: float, settle_s: float) -> Summary:
    return Simulation(scene, seed=1).run(seconds, settle_s)


def calm_pulse_n(seconds: float) -> Floats:
    """Return a pulse of 0.3 N with little variability and noise."""
    rng = np.random.default_rng(2)
    unit = drawn(make_rhythm(rng, seconds, 0.02, lambda _: 75.0), "wide", seconds, 0.8)
    return np.asarray(0.2 + 0.3 * unit / np.ptp(unit) + 5e-4 * rng.standard_normal(len(unit)))


def fibrillating_n(seconds: float) -> Floats:
    unit = drawn(fibrillating(np.random.default_rng(3), seconds), "wide", seconds, 0.8)
    return np.asarray(0.2 + 0.3 * unit / np.ptp(unit))


def moved_n(seconds: float) -> Floats:
    """Return a pulse whose hold-down force jumps twice a second, by some 0.1 N."""
    jumps_n = np.repeat(np.random.default_rng(4).normal(0, 0.1, round(2 * seconds) + 1), 500)
    return np.asarray(calm_pulse_n(seconds) + 0.2 + jumps_n[: round(1000 * seconds)])


@pytest.mark.parametrize("trouble_n", [fibrillating_n, moved_n], ids=["fibrillation", "movement"])
def test_auto_compensates_a_calm_pulse_and_buffers_a_troubled_one(
    trouble_n: Callable[[float], Floats], tmp_path: Path
) -> None:
    pulse_n = np.concatenate([calm_pulse_n(CALM_S), trouble_n(TROUBLED_S)])
    ticks: list[tuple[int, float, int, float, bool]] = []

    def watch(tick: TickState) -> None:
        delay_ms = tick.playout_delay_ns / MS
        ticks.append((tick.now_ns, delay_ms, tick.instant_ns, tick.target_n, tick.trusted))

    simulation = Simulation(scene(WAN, "stack", pulse_n=pulse_n, folder=tmp_path), seed=1)
    summary = simulation.run(CALM_S + TROUBLED_S, watch=watch)
    now_ns, delay_ms, instant_ns, target_n, trusted = map(np.array, zip(*ticks, strict=True))
    at_s = now_ns * 1e-9 - STREAM_BEGINS_S

    def within(from_s: float, to_s: float) -> NDArray[np.bool_]:
        return np.asarray((from_s <= at_s) & (at_s < to_s))

    # The pulse's height is known after 2 s. E then falls as the predictor learns.
    assert not trusted[within(0, 2)].any()
    assert delay_ms[within(0, 2)].min() > 50
    assert trusted[within(8, CALM_S)].all()
    assert delay_ms[within(8, 9)].max() < 40
    assert np.abs(delay_ms[within(15, CALM_S)]).max() < 0.5
    # E rises within three seconds in the trouble, and stays longer while that lasts.
    assert delay_ms[within(CALM_S + 3, CALM_S + TROUBLED_S)].min() > 15
    assert summary.compensation.trusted == pytest.approx(float(np.mean(trusted)), abs=0.05)
    warp = np.diff(instant_ns) / MS
    assert warp.min() >= 0.95 - 1e-6
    assert warp.max() <= 1.05 + 1e-6
    # While E falls from 60 ms to 0, no step exceeds the steps of the pulse.
    own_n = np.abs(np.diff(pulse_n[: round(1000 * CALM_S)])).max()
    assert np.abs(np.diff(target_n[within(10, CALM_S)])).max() < 1.2 * own_n


def test_trust_brings_the_pulse_nearly_into_phase() -> None:
    linear, stack = (played(scene(WAN, name), 33, 28) for name in ("linear", "stack"))
    assert known(stack.compensation.trusted) > 0.15
    assert known(stack.force_rmse_n.in_phase) < 0.1 * known(linear.force_rmse_n.in_phase)
    assert stack.within_jnd == 1.0


def test_a_stall_that_prediction_bridges_costs_no_trust() -> None:
    stack = played(scene(STALLS, "stack"), 46, 42)
    assert known(stack.compensation.trusted) > 0.2
    # With buffering, which needs 144 ms, the error in phase would be 0.11 N.
    assert known(stack.force_rmse_n.in_phase) < 0.08


@pytest.mark.parametrize(
    ("link", "batch_ms"),
    [("delay=40ms,jitter=10ms", 10), (STALLS, 5)],
)
def test_a_predicted_pulse_is_not_much_rougher_than_the_sensed_one(
    link: str, batch_ms: int
) -> None:
    summary = played(scene(link, "stack", 0, batch_ms), 24, 16)
    assert known(summary.roughness.energy_ratio) <= 2
    assert summary.compensation.predicted == pytest.approx(1)
    assert summary.playout_delay_ms.mean == pytest.approx(0, abs=3)


def test_a_delay_above_the_stale_limit_can_be_compensated() -> None:
    # The age of 80 ms, which every sample has, does not make the stream stale.
    summary = played(scene("delay=80ms", "stack", 0), 16, 12)
    assert known(summary.force_rmse_n.in_phase) < 0.015
