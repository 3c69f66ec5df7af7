import math

import numpy as np
import pytest

from display_node.plant.scene import StepperScene
from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from protocol.errors import BenchError
from telepulse.commissioning.press import GUARD, PressRecorder, press_stepper, profile
from telepulse.commissioning.rig import FilmSample, ModelRig, Rig
from telepulse.scene import load_scene

SILENT_S = 0.06


def bench(name: str = "bench", **actuator: float) -> tuple[DisplayScene, StepperScene]:
    display = load_scene(find_scene(name)).display
    assert isinstance(display.actuator, StepperScene)
    changed = display.actuator.model_copy(update=actuator)
    return display.model_copy(update={"actuator": changed}), changed


def recorder(rig: Rig) -> PressRecorder:
    return PressRecorder(rig, GUARD * 0.3, SILENT_S)


class Broken(ModelRig):
    """A rig whose film reads one force, or nothing, from a tick on."""

    def __init__(self, scene: DisplayScene, at: int, reads_n: float | None) -> None:
        super().__init__(scene)
        self._at, self._reads_n = at, reads_n
        self.ticks, self.stopped_at = 0, -1

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        self.ticks += 1
        commanded_s, samples = super().tick(output)
        if self.ticks < self._at:
            return commanded_s, samples
        broken = [] if self._reads_n is None else [(commanded_s, self._reads_n)]
        return commanded_s, broken

    def withdraw(self) -> None:
        self.stopped_at = self.ticks


def test_a_profile_makes_its_travel_within_its_acceleration() -> None:
    for travel_m in (1e-6, 25e-6, -3e-4):
        speeds = profile(travel_m, 10.0, 1e-3)
        assert sum(speeds) * 1e-3 == pytest.approx(travel_m)
        assert np.max(np.abs(np.diff([0.0, *speeds, 0.0]))) <= 10.0 * 1e-3 * 1.0001


def test_a_press_keeps_to_its_force_and_ends_where_it_began() -> None:
    display, actuator = bench()
    pressed = recorder(ModelRig(display))
    press_stepper(pressed, actuator, 0.3)
    assert 0.28 < max(pressed.film_n) < 0.33
    assert pressed.film_n[-1] == 0.0
    assert sum(pressed.output) * 1e-3 == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(
    ("reads_n", "reason", "latest"),
    [
        *((reads_n, r"the film reads .* above 0.45 N", 1500) for reads_n in (0.5, -0.5, math.nan)),
        (None, "no reading of the film for 60 ms", 1560),
    ],
)
def test_a_press_stops_when_the_film_reads_too_much_or_nothing(
    reads_n: float | None, reason: str, latest: int
) -> None:
    display, actuator = bench()
    rig = Broken(display, at=1500, reads_n=reads_n)
    with pytest.raises(BenchError, match=reason):
        press_stepper(recorder(rig), actuator, 0.3)
    assert rig.stopped_at == rig.ticks == pytest.approx(latest, abs=0 if latest == 1500 else 5)


def test_a_finger_that_is_not_there_is_not_searched_for_ever() -> None:
    _, actuator = bench()
    rig = Broken(bench(fingertip_n_per_m=50.0)[0], 10**9, None)
    with pytest.raises(BenchError, match="nothing was touched on 3 mm"):
        press_stepper(recorder(rig), actuator, 0.3)
    assert rig.stopped_at == rig.ticks


def test_a_stop_much_harder_than_the_scenes_finger_is_not_pressed_hard() -> None:
    _, actuator = bench()
    pressed = recorder(ModelRig(bench(fingertip_n_per_m=50_000.0)[0]))
    press_stepper(pressed, actuator, 0.3)
    assert max(pressed.film_n) < GUARD * 0.3
