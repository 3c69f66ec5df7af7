import math
from itertools import pairwise

import numpy as np
import pytest

from display_node.control.force_loop import HELD_S, ForceLoop, build_force_loop
from display_node.control.scene import ControllerScene
from display_node.plant.scene import FilmTable, SecondOrderScene, StepperScene
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from tests.support.refusals import refusal_of

TICK_S = 1e-3
HELD_TICKS = round(HELD_S / TICK_S)
LIMIT_N = 2.5
STEPPER = StepperScene.model_validate({"kind": "stepper"})
SECOND_ORDER = SecondOrderScene.model_validate({"kind": "second_order"})
FILM = FilmTable()
FOLLOWING = {"kp": 100, "error": "position", "feed_forward": True}
PAPERS_EXPERIMENT = {
    "kp": 15,
    "ki": 0.15,
    "kd": 0.03,
    "error": "millivolts",
    "derivative_filter": "200 Hz",
}


# 8 s of the paper's pulse: 0.3 N from peak to peak, on 0.3 N.
SOURCE = SyntheticScene.model_validate({"kind": "synthetic", "preset": "paper"})
PULSE_N = SyntheticSource(SOURCE).take(8001)[:, 0]


def force_loop(
    controller: dict[str, object],
    actuator: SecondOrderScene | StepperScene = STEPPER,
    limit_n: float = LIMIT_N,
    film: FilmTable = FILM,
    **limits: float,
) -> ForceLoop:
    gains = ControllerScene.model_validate(controller)
    return build_force_loop(gains, actuator, ElasticLayer(), film, limit_n, TICK_S, **limits)


def tick(loop: ForceLoop, *reference_n: float) -> float:
    loop.tick(list(reference_n), loop.read_film())
    return loop.felt_n


def rmse_n(loop: ForceLoop) -> float:
    """Return the error of the force at each tick's beginning, once it follows the pulse."""
    felt_n = []
    for now_n, next_n in pairwise(PULSE_N.tolist()):
        felt_n.append(loop.felt_n)
        tick(loop, now_n, next_n)
    error_n = np.array(felt_n) - PULSE_N[:-1]
    return float(np.sqrt(np.mean(error_n[2000:] ** 2)))


def test_with_feed_forward_a_steppers_error_is_that_of_quantisation() -> None:
    law, step_m = STEPPER.contact(ElasticLayer()), STEPPER.step_m
    nearest_n = [law.force(round(law.position(n) / step_m) * step_m) for n in PULSE_N.tolist()]
    # The least RMSE of any drive with microsteps of 0.625 µm.
    floor_n = np.sqrt(np.mean((np.array(nearest_n) - PULSE_N) ** 2))
    assert floor_n == pytest.approx(0.18e-3, abs=0.01e-3)
    assert rmse_n(force_loop(FOLLOWING)) <= 0.25e-3


@pytest.mark.parametrize(
    ("gains", "actuator", "least_n", "most_n"),
    [
        # Without feed-forward a stepper lags.
        ({"kp": 100, "error": "position"}, STEPPER, 5e-3, 50e-3),
        ({"kp": 300, "error": "position"}, STEPPER, 5e-3, 50e-3),
        ({"kp": 0.1}, STEPPER, 5e-3, 50e-3),
        ({"kp": 0.1, "ki": 0.15, "kd": 1e-4}, STEPPER, 5e-3, 50e-3),
        # On its actuator, the paper's gains follow the pulse in millivolts, but not in newtons.
        (PAPERS_EXPERIMENT, SECOND_ORDER, 0, 2e-3),
        (PAPERS_EXPERIMENT | {"error": "force"}, SECOND_ORDER, 20e-3, math.inf),
    ],
)
def test_the_error_without_feed_forward(
    gains: dict[str, object],
    actuator: SecondOrderScene | StepperScene,
    least_n: float,
    most_n: float,
) -> None:
    assert least_n < rmse_n(force_loop(gains, actuator)) < most_n


def test_the_voltage_is_limited() -> None:
    weak = SecondOrderScene.model_validate({"kind": "second_order", "voltage_limit": 1.0})
    loop = force_loop(PAPERS_EXPERIMENT, weak)
    for _ in range(20_000):
        tick(loop, 2.0, 2.0)
    # 1 V gives 1/k newtons; the model's own ringing exceeds this.
    assert 0.1 < loop.felt_n < 2 / 4.23


@pytest.mark.parametrize("limit_n", [0.4, 2.5])
def test_no_reference_presses_harder_than_the_limit(limit_n: float) -> None:
    loop = force_loop(FOLLOWING, limit_n=limit_n)
    rng = np.random.default_rng(3)
    for now_n, next_n in rng.uniform(-5, 10, (3000, 2)).tolist():
        assert 0 <= tick(loop, now_n, next_n) <= limit_n


@pytest.mark.parametrize("gains", [{"kp": 1, "feed_forward": True}, {"kp": 1, "error": "position"}])
def test_gains_that_need_a_contact_law_are_refused_without_one(gains: dict[str, object]) -> None:
    assert "need a stepper's contact law" in refusal_of(SceneError, force_loop, gains, SECOND_ORDER)


def test_a_loop_at_rest_stays_at_rest() -> None:
    for loop in (force_loop(FOLLOWING), force_loop(PAPERS_EXPERIMENT, SECOND_ORDER)):
        # Before the first command there is nothing to go on with.
        loop.coast(10)
        assert loop.felt_n == 0.0
        assert [tick(loop, 0.0, 0.0) for _ in range(100)] == [0.0] * 100


def rising(loop: ForceLoop) -> ForceLoop:
    """Return the loop after 0.5 s of a ramp of 1 N/s."""
    for milli in range(500):
        tick(loop, milli * 1e-3, (milli + 1) * 1e-3)
    return loop


@pytest.mark.parametrize("ticks", [0, 1, 10, HELD_TICKS])
def test_the_last_command_holds_during_missed_ticks(ticks: int) -> None:
    loop = rising(force_loop(FOLLOWING))
    before_n = loop.felt_n
    loop.coast(ticks)
    assert ticks or loop.felt_n == before_n
    assert loop.felt_n - before_n == pytest.approx(ticks * 1e-3, abs=1e-3 + 0.03e-3 * ticks)


@pytest.mark.parametrize("ticks", [150, 5000, 10**12])
def test_a_long_stall_is_stopped_by_the_watchdog(ticks: int) -> None:
    loop = rising(force_loop(FOLLOWING))
    before_n = loop.felt_n
    loop.coast(ticks)
    stopped_n = loop.felt_n
    assert stopped_n - before_n == pytest.approx(HELD_S * 1.0, rel=0.05)
    loop.coast(50)
    assert loop.felt_n == stopped_n
    for _ in range(300):  # the loop follows the reference again
        felt_n = tick(loop, 0.5, 0.5)
    assert felt_n == pytest.approx(0.5, abs=0.7e-3)


@pytest.mark.parametrize(("ticks", "moving_s"), [(150, 0.15), (350, 0.2)])
def test_an_actuator_that_keeps_its_speed_longer_moves_on_for_longer(
    ticks: int, moving_s: float
) -> None:
    loop = rising(force_loop(FOLLOWING, held_s=0.2))
    before_n = loop.felt_n
    loop.coast(ticks)
    assert loop.felt_n - before_n == pytest.approx(moving_s * 1.0, rel=0.05)


@pytest.mark.parametrize(("ticks", "least_n", "most_n"), [(200, 0, 0), (HELD_TICKS, 0.3, math.inf)])
def test_a_fast_drive_brakes_in_a_stall_beyond_the_watchdog(
    ticks: int, least_n: float, most_n: float
) -> None:
    loop = force_loop({"kp": 1000}, limit_n=100.0)
    for _ in range(20):
        tick(loop, 90.0, 90.0)
    loop.coast(ticks)
    stopped_n = loop.felt_n
    assert 15 < stopped_n < 40
    loop.coast(1)
    assert least_n <= loop.felt_n - stopped_n <= most_n


def test_a_loop_that_catches_up_rises_no_faster_than_the_slew_limit() -> None:
    slew_n_per_s = 5.0
    loop = force_loop(FOLLOWING, slew_limit_n_per_s=slew_n_per_s)
    felt_n = [tick(loop, 1.0, 1.0) for _ in range(400)]
    # The bound holds for the finger's stiffness at the reference, and up to a microstep.
    assert np.diff(felt_n).max() <= slew_n_per_s * TICK_S + 1.1e3 * STEPPER.step_m
    assert felt_n[-1] == pytest.approx(1.0, abs=1e-3)


def test_a_slow_films_model_advances_in_missed_ticks() -> None:
    film = FilmTable.model_validate({"filter": "40 Hz"})
    loop = rising(force_loop(FOLLOWING | {"observer": {"wander": "20 µm"}}, film=film))
    loop.coast(20)
    errors_n = []
    for milli in range(520, 570):
        errors_n.append(loop.felt_n - milli * 1e-3)
        tick(loop, milli * 1e-3, (milli + 1) * 1e-3)
    # The force rose by 20 mN meanwhile; without the advance the error would be as large.
    assert max(map(abs, errors_n)) < 3e-3
