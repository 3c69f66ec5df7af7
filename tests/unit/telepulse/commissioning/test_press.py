import math

import numpy as np
import pytest

from display_node.plant.stepper import StepperScene
from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from protocol.errors import BenchError
from telepulse.commissioning.press import GUARD, PressRecorder, press_stepper, profile
from telepulse.commissioning.rig import FilmSample, ModelRig
from telepulse.scene import load_scene

SILENT_S = 0.06


def bench(name: str = "bench", **actuator: float) -> tuple[DisplayScene, StepperScene]:
    display = load_scene(find_scene(name)).display
    assert isinstance(display.actuator, StepperScene)
    changed = display.actuator.model_copy(update=actuator)
    return display.model_copy(update={"actuator": changed}), changed


class Broken:
    """A rig that goes wrong at a tick."""

    def __init__(self, rig: ModelRig, at: int, reads_n: float | None) -> None:
        self.tick_s = rig.tick_s
        self._rig = rig
        self._at = at
        self._reads_n = reads_n
        self.ticks = 0
        self.stopped_at = -1

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        self.ticks += 1
        commanded_s, samples = self._rig.tick(output)
        if self.ticks < self._at:
            return commanded_s, samples
        return commanded_s, [] if self._reads_n is None else [
            FilmSample(commanded_s, self._reads_n)
        ]

    def withdraw(self) -> None:
        self.stopped_at = self.ticks


def test_a_profile_makes_its_travel_within_its_acceleration() -> None:
    for travel_m in (1e-6, 25e-6, -3e-4):
        speeds = profile(travel_m, 10.0, 1e-3)
        assert sum(speeds) * 1e-3 == pytest.approx(travel_m)
        assert np.max(np.abs(np.diff([0.0, *speeds, 0.0]))) <= 10.0 * 1e-3 * 1.0001


def test_a_press_keeps_to_its_force_and_ends_where_it_began() -> None:
    display, actuator = bench()
    recorder = PressRecorder(ModelRig(display), GUARD * 0.3, SILENT_S)
    press_stepper(recorder, actuator, 0.3)
    assert 0.28 < max(recorder.film_n) < 0.33
    assert recorder.film_n[-1] == 0.0
    assert sum(recorder.output) * 1e-3 == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("reads_n", [0.5, -0.5, math.nan])
def test_it_stops_at_once_when_the_film_reads_too_much(reads_n: float) -> None:
    display, actuator = bench()
    rig = Broken(ModelRig(display), at=1500, reads_n=reads_n)
    with pytest.raises(BenchError, match=r"the film reads .* above 0.45 N"):
        press_stepper(PressRecorder(rig, GUARD * 0.3, SILENT_S), actuator, 0.3)
    assert rig.stopped_at == rig.ticks == 1500


def test_it_stops_when_the_film_falls_silent() -> None:
    display, actuator = bench()
    rig = Broken(ModelRig(display), at=1500, reads_n=None)
    with pytest.raises(BenchError, match="no reading of the film for 60 ms"):
        press_stepper(PressRecorder(rig, GUARD * 0.3, SILENT_S), actuator, 0.3)
    assert rig.stopped_at == rig.ticks
    assert 1555 <= rig.ticks <= 1565


def test_a_finger_that_is_not_there_is_not_searched_for_ever() -> None:
    display, actuator = bench()
    soft = actuator.model_copy(update={"fingertip_n_per_m": 50.0})
    rig = Broken(ModelRig(display.model_copy(update={"actuator": soft})), 10**9, None)
    with pytest.raises(BenchError, match="nothing was touched on 3 mm"):
        press_stepper(PressRecorder(rig, GUARD * 0.3, SILENT_S), actuator, 0.3)
    assert rig.stopped_at == rig.ticks


def test_a_stop_much_harder_than_the_scenes_finger_is_not_pressed_hard() -> None:
    display, actuator = bench()
    hard = actuator.model_copy(update={"fingertip_n_per_m": 50_000.0})
    recorder = PressRecorder(
        ModelRig(display.model_copy(update={"actuator": hard})), GUARD * 0.3, SILENT_S
    )
    press_stepper(recorder, actuator, 0.3)
    assert max(recorder.film_n) < GUARD * 0.3


def test_samples_and_outputs_are_kept_as_commanded() -> None:
    display, _ = bench()
    recorder = PressRecorder(ModelRig(display), 1.0, SILENT_S)
    recorder.run([0.0, 0.01, 0.02])
    assert recorder.output == [0.0, 0.01, 0.02]
    assert recorder.commanded_s == pytest.approx([0.0, 1e-3, 2e-3])
    assert recorder.film_s == pytest.approx([1e-3, 2e-3, 3e-3], abs=1e-6)
