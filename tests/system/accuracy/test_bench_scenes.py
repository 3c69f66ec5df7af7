"""Force error and slew of the scenes of a bench, with their actuator and with others."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.force_loop import ForceLoop
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from tests.support.scene_loops import felt_under_jumps
from tests.support.streams import synthetic

SCENES = Path(__file__).parents[3] / "scenes"
# RMSE that the paper printed of its experiment.
PAPERS_RMSE_N = 20.863e-3


def display_scene(name: str) -> DisplayScene:
    return load_section(SCENES / f"{name}.toml", "display", DisplayScene)


def scenes_loop(name: str, **actually: object) -> ForceLoop:
    """Return the loop of a scene on its actuator, changed by `actually`."""
    scene = display_scene(name)
    return scene.force_loop(scene.actuator.model_copy(update=actually))


def errors_n(
    loop: ForceLoop, pulse_n: NDArray[np.float64], lead_ticks: float = 0.0
) -> NDArray[np.float64]:
    """Return the force error at the begin of each tick, with a reference known ahead.

    lead_ticks: ticks from now to the begin of the loop's reference.
    """
    ticks, ahead = np.arange(len(pulse_n)), loop.horizon
    reference = np.interp(ticks + lead_ticks, ticks, pulse_n).tolist()
    felt_n = []
    for now in range(len(reference) - ahead):
        felt_n.append(loop.felt_n)
        loop.tick(reference[now : now + ahead + 1], loop.read_film())
    return np.array(felt_n) - pulse_n[: len(felt_n)]


def rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def breathing_n() -> NDArray[np.float64]:
    """Return 8 s of the scenes' pulse, with respiration."""
    return synthetic(preset="paper", respiration=0.256).take(8001)[:, 0]


# Different noise of the same film: readings before the pulse begins.
@pytest.mark.parametrize(
    ("name", "readings", "rmse_n", "peak_n"),
    [
        ("bench", 0, 0.3e-3, 1e-3),
        *(("real_bench", readings, 4e-3, 15e-3) for readings in (0, 317, 1000)),
        ("paper", 0, 2e-3, math.inf),
    ],
)
def test_errors_of_the_benches_are_those_of_their_quantisation_and_noise(
    breathing_n: NDArray[np.float64], name: str, readings: int, rmse_n: float, peak_n: float
) -> None:
    loop = scenes_loop(name)
    for _ in range(readings):
        loop.read_film()
    found_n = errors_n(loop, breathing_n)[2000:]
    assert rms(found_n) <= rmse_n
    assert np.abs(found_n).max() <= peak_n


@pytest.mark.parametrize(("drive_ms", "film_ms"), [(1, 0), (0, 5), (2, 3), (2.5, 3.3)], ids=str)
def test_latencies_of_drive_and_film_are_compensated(
    breathing_n: NDArray[np.float64], drive_ms: float, film_ms: float
) -> None:
    scene = display_scene("real_bench")
    late = scene.model_copy(
        update={
            "actuator": scene.actuator.model_copy(update={"latency_ns": round(drive_ms * 1e6)}),
            "film": scene.film.model_copy(update={"latency_ns": round(film_ms * 1e6)}),
        }
    )
    found_n = errors_n(late.force_loop(), breathing_n, lead_ticks=drive_ms)[2000:-100]
    assert rms(found_n) <= 2e-3
    if drive_ms:
        without_lead_n = errors_n(late.force_loop(), breathing_n)[2000:-100]
        assert rms(without_lead_n) > 2 * rms(found_n)


@pytest.mark.parametrize(
    "actually",
    [
        {"fingertip_n_per_m": 0.8e3},
        {"fingertip_n_per_m": 1.2e3},
        {"backlash_m": 0.0},
        {"backlash_m": 20e-6},
        {"rotor_resonance_hz": 80.0},
        {"rotor_resonance_hz": 120.0},
    ],
    ids=str,
)
def test_another_actuator_than_the_scenes_has_less_than_half_the_papers_error(
    breathing_n: NDArray[np.float64], actually: dict[str, object]
) -> None:
    found_n = errors_n(scenes_loop("real_bench", **actually), breathing_n[:4001])
    assert rms(found_n[2000:]) < 0.5 * PAPERS_RMSE_N
    assert np.abs(found_n[1000:]).max() < 0.1


def test_another_actuator_on_the_clean_bench_is_corrected_by_its_film(
    breathing_n: NDArray[np.float64],
) -> None:
    loop = scenes_loop("bench", fingertip_n_per_m=0.8e3)
    assert 0.3e-3 < rms(errors_n(loop, breathing_n[:4001])[2000:]) < 0.5 * PAPERS_RMSE_N


@pytest.mark.parametrize("reading_n", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["bench", "real_bench", "paper"])
def test_readings_that_are_not_finite_press_no_harder_than_the_limit(
    name: str, reading_n: float
) -> None:
    loop = scenes_loop(name)
    reference_n = [0.3] * (loop.horizon + 1)
    for _ in range(500):
        loop.tick(reference_n, loop.read_film())
    for _ in range(100):
        assert loop.tick(reference_n, reading_n) <= 2.5


# For one microstep, and the loop's correction.
MARGIN = 1.02


# Not real_bench: its rotor rings when its speed jumps, which no bound on the speed prevents.
@pytest.mark.parametrize("name", ["radial", "tmcl_bench"])
def test_forces_that_jump_are_felt_within_the_slew_limit_up_and_down(name: str) -> None:
    scene = display_scene(name)
    limit_n_per_s = scene.safety.slew_limit_n_per_s
    slews_n_per_s = np.diff(felt_under_jumps(scene, jumps=100)) / (scene.tick_ns * 1e-9)
    assert 0.9 * limit_n_per_s < slews_n_per_s.max() <= MARGIN * limit_n_per_s
    assert 0.9 * limit_n_per_s < -slews_n_per_s.min() <= MARGIN * limit_n_per_s
