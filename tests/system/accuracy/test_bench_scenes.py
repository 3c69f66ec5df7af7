"""The scenes of a bench: how true they are, and on another actuator than they say."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.force_loop import ForceLoop
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from tests.support.streams import synthetic

SCENES = Path(__file__).parents[3] / "scenes"
# What the paper printed of its experiment.
PAPERS_RMSE_N = 20.863e-3


def scenes_loop(name: str, **actually: object) -> ForceLoop:
    """The loop of a scene on an actuator that is as the scene says but for `actually`."""
    return built(load_section(SCENES / f"{name}.toml", "display", DisplayScene), **actually)


def built(scene: DisplayScene, **actually: object) -> ForceLoop:
    return scene.force_loop(scene.actuator.model_copy(update=actually))


def off_n(
    loop: ForceLoop, pulse_n: NDArray[np.float64], lead_ticks: float = 0.0
) -> NDArray[np.float64]:
    """Return the force error at each tick's beginning, the reference known ahead.

    lead_ticks: how much later than now the loop's reference begins.
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
    """8 s of the scenes' pulse, which swings with the breath."""
    return synthetic(preset="paper", respiration=0.256).take(8001)[:, 0]


def test_the_clean_bench_is_true_to_its_quantisation(breathing_n: NDArray[np.float64]) -> None:
    errors_n = off_n(scenes_loop("bench"), breathing_n)
    assert rms(errors_n[2000:]) <= 0.3e-3
    assert np.abs(errors_n[2000:]).max() <= 1e-3


@pytest.mark.parametrize(("drive_ms", "film_ms"), [(1, 0), (0, 5), (2, 3), (2.5, 3.3)], ids=str)
def test_a_bench_that_answers_late_is_as_true(
    breathing_n: NDArray[np.float64], drive_ms: float, film_ms: float
) -> None:
    scene = load_section(SCENES / "real_bench.toml", "display", DisplayScene)
    late = scene.model_copy(
        update={
            "actuator": scene.actuator.model_copy(update={"latency_ns": round(drive_ms * 1e6)}),
            "film": scene.film.model_copy(update={"latency_ns": round(film_ms * 1e6)}),
        }
    )
    errors_n = off_n(built(late), breathing_n, lead_ticks=drive_ms)[2000:-100]
    assert rms(errors_n) <= 2e-3
    # It is the lead that does it.
    if drive_ms:
        assert rms(off_n(built(late), breathing_n)[2000:-100]) > 2 * rms(errors_n)


# Other noise from the same film: it has been on for so many ticks before.
@pytest.mark.parametrize("on_before", [0, 317, 1000])
def test_the_real_bench_is_true_to_4_mn(breathing_n: NDArray[np.float64], on_before: int) -> None:
    loop = scenes_loop("real_bench")
    for _ in range(on_before):
        loop.read_film()
    errors_n = off_n(loop, breathing_n)
    assert rms(errors_n[2000:]) <= 4e-3
    assert np.abs(errors_n[2000:]).max() <= 15e-3


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
def test_another_actuator_than_the_scenes_is_still_followed_better_than_the_paper_did(
    breathing_n: NDArray[np.float64], actually: dict[str, object]
) -> None:
    errors_n = off_n(scenes_loop("real_bench", **actually), breathing_n[:4001])
    assert rms(errors_n[2000:]) < 0.5 * PAPERS_RMSE_N
    assert np.abs(errors_n[1000:]).max() < 0.1


def test_another_actuator_on_the_clean_bench_is_corrected_by_its_film(
    breathing_n: NDArray[np.float64],
) -> None:
    softer = rms(off_n(scenes_loop("bench", fingertip_n_per_m=0.8e3), breathing_n[:4001])[2000:])
    assert 0.3e-3 < softer < 0.5 * PAPERS_RMSE_N


def test_the_papers_scene_follows_better_than_the_paper_did(
    breathing_n: NDArray[np.float64],
) -> None:
    assert rms(off_n(scenes_loop("paper"), breathing_n)[2000:]) < 2e-3


@pytest.mark.parametrize("reading_n", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["bench", "real_bench", "paper"])
def test_readings_that_are_no_numbers_press_no_harder_than_the_limit(
    name: str, reading_n: float
) -> None:
    loop = scenes_loop(name)
    reference_n = [0.3] * (loop.horizon + 1)
    for _ in range(500):
        loop.tick(reference_n, loop.read_film())
    for _ in range(100):
        assert loop.tick(reference_n, reading_n) <= 2.5
