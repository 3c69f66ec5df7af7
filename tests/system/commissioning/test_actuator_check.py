import math
from dataclasses import replace

import pytest

from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from telepulse.commissioning.actuator_check import (
    ActuatorFindings,
    check_actuator,
    check_latency,
)
from telepulse.commissioning.identification import IdentifiedModel, SecondOrderModel
from telepulse.commissioning.press import ContactFit
from telepulse.commissioning.rig import FilmSample, ModelRig
from telepulse.scene import load_scene
from tests.unit.telepulse.commissioning.test_press import bench


def checked(real: DisplayScene, scene: DisplayScene | None = None) -> ActuatorFindings:
    """Check a bench with a scene, by default with its own."""
    scene = scene or real
    return check_actuator(ModelRig(real), scene, 0.3, scene.film.latency_ns * 1e-9)


def verdicts(actuator: ActuatorFindings) -> dict[str, str]:
    return {check.name: check.verdict for check in actuator.checks if check.verdict != "ok"}


def number(actuator: ActuatorFindings, key: str) -> float:
    return float(str(actuator.keys[key]).split()[0])


def test_the_papers_actuator_is_found_exactly() -> None:
    found = checked(load_scene(find_scene("paper")).display)
    assert found.keys == {"m": 0.65, "c": 0.61, "k": 4.23}
    assert verdicts(found) == {}


def test_the_films_share_of_the_latency_is_not_the_drives() -> None:
    scene, _ = bench(latency_ns=4_000_000)
    late_film = scene.film.model_copy(update={"latency_ns": 5_000_000})
    scene = scene.model_copy(update={"film": late_film})
    assert number(checked(scene), "latency") == pytest.approx(4.0, abs=0.2)


def test_a_tick_that_was_late_does_not_change_the_latency() -> None:
    class Late(ModelRig):
        """A rig whose tick, while nothing moves, takes almost half a tick longer, once."""

        ticks = 0

        def tick(self, output: float) -> tuple[float, list[FilmSample]]:
            commanded_s, samples = super().tick(output)
            self.ticks += 1
            late_s = 0.45 * self.tick_s if self.ticks > 100 else 0.0
            return commanded_s + late_s, [(at_s + late_s, force_n) for at_s, force_n in samples]

    scene, _ = bench(latency_ns=4_000_000)
    found = check_actuator(Late(scene), scene, 0.3, scene.film.latency_ns * 1e-9)
    assert number(found, "latency") == pytest.approx(number(checked(scene), "latency"), abs=0.1)


def test_a_ringing_rotor_is_found_through_a_slow_noisy_film() -> None:
    found = checked(bench("real_bench", backlash_m=0.0, latency_ns=4_200_000)[0])
    assert number(found, "rotor_resonance") == pytest.approx(100.0, abs=5.0)
    assert number(found, "rotor_damping") == pytest.approx(0.2, abs=0.05)
    assert number(found, "latency") == pytest.approx(4.2, abs=0.2)
    assert found.identified.model.k == pytest.approx(1.0, abs=0.01)


def test_backlash_is_found_and_then_the_rotor_is_left_as_it_was() -> None:
    real, _ = bench("real_bench", fingertip_n_per_m=1500.0, backlash_m=14e-6)
    found = checked(real, bench("real_bench")[0])
    assert number(found, "backlash") == pytest.approx(14.0, abs=1.5)
    assert number(found, "fingertip") == pytest.approx(1500.0, rel=0.02)
    assert "rotor_resonance" not in found.keys
    assert verdicts(found) == {"finger": "warn", "backlash": "warn"}


def test_a_drive_that_loses_steps_is_named() -> None:
    class Losing(ModelRig):
        """A drive that makes half of the commanded travel: wrong microsteps, or lost steps."""

        def tick(self, output: float) -> tuple[float, list[FilmSample]]:
            return super().tick(output / 2)

    scene, actuator = bench()
    losing = Losing(bench(lead_m=actuator.lead_m / 2)[0])
    found = check_actuator(losing, scene, 0.3, 0.0)
    assert number(found, "fingertip") == pytest.approx(500.0, rel=0.05)
    assert verdicts(found)["finger"] == "warn"


SHARP = SecondOrderModel(2.6e-6, 1.1e-3, 1.0)
FOUND = IdentifiedModel(SHARP, (0.0,) * 4, zero_n=0.0, nrmse=0.02, undetermined=(), delay_s=2e-3)
FITTED = ContactFit(1000.0, 2.0, 0.0, 0.0, 1e-6, unexplained=0.01)


@pytest.mark.parametrize(
    ("latency_s", "found", "verdict"),
    [
        (0.9e-3, FOUND, "ok"),
        (-0.98e-3, FOUND, "warn"),
        (-2.5e-3, FOUND, "fail"),
        (math.nan, FOUND, "fail"),
        (0.9e-3, replace(FOUND, nrmse=0.4), "warn"),
        (0.9e-3, replace(FOUND, undetermined=("latency",)), "warn"),
        (49.5e-3, replace(FOUND, delay_s=50e-3), "fail"),
    ],
)
def test_a_latency_that_no_drive_can_have_or_of_a_bad_fit_is_not_ok(
    latency_s: float, found: IdentifiedModel, verdict: str
) -> None:
    _, actuator = bench(latency_ns=400_000)
    check, plausible = check_latency(
        actuator, found, FITTED, latency_s, line_latency_s=0.78e-3, tick_s=2e-3
    )
    assert (check.verdict, plausible) == (verdict, verdict == "ok")
    assert (check.reason == "") is plausible
