"""Sweeps of the modelled wrist in virtual time."""

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.press.sweep import DepthSweep, SweepPlan
from display_node.scoring.depth_curve import BeatPoint
from protocol.errors import DepthError
from protocol.wire.messages import channel_samples
from sensing_node.press.probe import ProbeLimits
from sensing_node.sources.wrist import Wrist, WristScene
from telepulse.simulation.simulated_run import sweep_wrist

SECOND_NS = 1_000_000_000


class Disturbed(Wrist):
    """A wrist whose samples are changed by a function of the time in s and the samples."""

    change: Callable[[float, NDArray[np.float64]], NDArray[np.float64]]

    def take(self, count: int) -> NDArray[np.float64]:
        at_s = self._time_ns * 1e-9
        return self.change(at_s, super().take(count))


def wrist_scene() -> WristScene:
    return WristScene.model_validate({"kind": "wrist", "noise": "1 mN"})


def sweep(wrist: Wrist, ramp_ns: int | None = None) -> DepthSweep:
    run = DepthSweep(SweepPlan(ramp_ns=ramp_ns))
    sweep_wrist(wrist, run, 2.5)
    return run


@pytest.mark.parametrize("ramp_ns", [None, 60 * SECOND_NS])
def test_the_best_hold_down_is_the_mean_arterial_pressure(ramp_ns: int | None) -> None:
    wrist = Wrist(wrist_scene())
    run = sweep(wrist, ramp_ns)
    curve = run.curve()
    assert run.fault == ""
    assert curve.best_n.value == pytest.approx(wrist.artery.best_n, rel=0.05)
    light_n, deepest_n = curve.light_n, curve.deepest_n
    assert light_n is not None
    assert deepest_n is not None
    for level in (light_n, deepest_n):
        share = wrist.artery.height_n(level.value) / wrist.artery.height_n(wrist.artery.best_n)
        assert share == pytest.approx(0.5, abs=0.05)
    # The shape flattens beyond the best force.
    flat = {level.hold_down_n: level.good[0].flat for level in run.levels if level.good}
    assert flat[max(flat)] > flat[min(flat)] + 0.2
    # A closed artery is not pressed further, and at the end the wrist is released.
    assert max(level.wanted_n for level in run.levels) < 2.3
    assert wrist.force_n < 0.1


def test_knocks_are_doubtful_beats_and_do_not_move_the_best_force() -> None:
    def knock(at_s: float, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values + (0.15 if at_s % 4.3 < 0.12 else 0.0)

    wrist = Disturbed(wrist_scene())
    wrist.change = knock
    curve = sweep(wrist).curve()

    def wrong(points: Sequence[BeatPoint]) -> list[float]:
        errors = [each.height_n / wrist.artery.height_n(each.hold_down_n) - 1 for each in points]
        return [error for error in errors if abs(error) > 0.25]

    assert curve.best_n.value == pytest.approx(wrist.artery.best_n, rel=0.05)
    assert wrong(curve.points)
    assert not wrong(curve.good)


def test_a_steady_sweep_notes_the_probes_limit_and_ends_there() -> None:
    run, pressed_n = DepthSweep(SweepPlan(high_n=6.0, ramp_ns=30 * SECOND_NS)), []
    wrist = Disturbed(wrist_scene(), ProbeLimits(force_limit="1.3 N"))

    def watch(at_s: float, values: NDArray[np.float64]) -> NDArray[np.float64]:
        pressed_n.append(run.press_n)
        return values

    wrist.change = watch
    sweep_wrist(wrist, run, 6.0)
    assert "its limit" in run.notes[0]
    assert run.fault == ""
    assert max(pressed_n) < 2.3
    assert wrist.force_n < 0.1


@pytest.mark.parametrize(
    ("probe", "reason"), [("fault", "reports a fault"), ("held", "another display")]
)
def test_a_probe_that_cannot_be_pressed_ends_the_sweep(probe: str, reason: str) -> None:
    run = DepthSweep(SweepPlan())
    pulse = channel_samples(0, SECOND_NS, 1_000_000, [0.0] * 5)
    run.observe(pulse, [0.2] * 5)
    run.tick(SECOND_NS, probe)
    assert reason in run.fault
    assert run.press_n == 0.0
    assert not run.over
    run.observe(channel_samples(5, 3 * SECOND_NS, 1_000_000, [0.0] * 5), [0.0] * 5)
    run.observe(channel_samples(10, 5 * SECOND_NS, 1_000_000, [0.0] * 5), [0.0] * 5)
    assert run.over


def test_a_probe_that_does_not_move_ends_the_sweep() -> None:
    run = DepthSweep(SweepPlan())
    for number in range(0, 25_000, 5):
        run.observe(channel_samples(number, number * 1_000_000, 1_000_000, [0.0] * 5), [0.0] * 5)
    assert "does not press" in run.fault


def test_without_samples_the_sweep_ends_and_a_stop_before_the_first_ends_at_once() -> None:
    run = DepthSweep(SweepPlan())
    run.tick(0, None)
    assert not run.over
    run.tick(21 * SECOND_NS, None)
    assert run.over
    assert "no samples" in run.fault
    stopped = DepthSweep(SweepPlan())
    stopped.release()
    assert stopped.over


def test_a_stream_that_begins_anew_ends_the_sweep() -> None:
    run = DepthSweep(SweepPlan())
    run.restart()
    assert not run.over
    run.observe(channel_samples(0, SECOND_NS, 1_000_000, [0.0] * 5), [0.2] * 5)
    run.restart()
    assert run.over
    assert "began anew" in run.fault


def test_a_wrist_that_lies_is_pressed_no_harder_than_the_sweeps_limit() -> None:
    rng, plan = np.random.default_rng(3), SweepPlan(high_n=1.5)
    for size_n in (1.0, 1e6):
        run = DepthSweep(plan)
        for number in range(0, 60_000, 50):
            forces_n = (size_n * rng.standard_normal(50)).tolist()
            held_n = run.press_n * float(rng.choice([0.5, 1.0, 2.0]))
            run.observe(channel_samples(number, number * 1_000_000, 1_000_000, forces_n), [held_n])
            assert 0.0 <= run.press_n <= plan.high_n
        with suppress(DepthError):
            run.curve()
