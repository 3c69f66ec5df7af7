import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from display_node.plant.scene import SecondOrderScene
from display_node.plant.second_order import SecondOrder
from display_node.plant.stepper import Rotor
from protocol.errors import BenchError
from telepulse.commissioning.identification import (
    ActuatorInput,
    IdentifiedModel,
    SecondOrderModel,
    identify,
    respond,
    step_response,
)

TABLE_4 = SecondOrderModel(0.65, 0.61, 4.23)
# A rotor that rings at 100 Hz with ζ = 0.2.
STIFF = SecondOrderModel(1 / (200 * math.pi) ** 2, 0.4 / (200 * math.pi), 1.0)
TRIALS = 40


def stairs(
    count: int, dwell: tuple[int, int], seed: int, held: bool, tick_s: float
) -> ActuatorInput:
    rng, values, at = np.random.default_rng(seed), np.zeros(count), dwell[0]
    while at < count:
        rise = np.ones(count - at) if held else np.minimum(np.arange(count - at) / 5, 1.0)
        values[at:] += rise
        at += int(rng.integers(*dwell))
    return ActuatorInput(values, tick_s, held)


def trial(
    model: SecondOrderModel, command: ActuatorInput, noise: float, seed: int, colour: float = 0.0
) -> tuple[IdentifiedModel, NDArray[np.bool_]]:
    """The identified model, and which of m, c, k and latency lie within their intervals."""
    at_s = np.arange(len(command.values)) * command.tick_s
    white = np.random.default_rng(seed).standard_normal(len(at_s))
    off = lfilter([math.sqrt(1 - colour**2)], [1, -colour], white)
    found = identify(
        command, at_s, respond(model, command, at_s) + 0.1 + noise * off, 20 * command.tick_s
    )
    true = np.array([model.m, model.c, model.k, model.latency_s])
    return found, np.abs(np.array(found.values) - true) <= np.array(found.half_widths)


def test_the_response_to_a_held_input_is_the_actuators_own() -> None:
    volts = np.random.default_rng(1).standard_normal(500)
    volts[0] = 0.0
    actuator = SecondOrder(SecondOrderScene(kind="second_order"), 0.01)
    forces_n = [0.0, *map(actuator.step, volts[:-1].tolist())]
    command = ActuatorInput(volts, 0.01, held=True)
    assert respond(TABLE_4, command, np.arange(500) * 0.01) == pytest.approx(forces_n, abs=1e-12)


def test_the_response_to_a_straight_input_is_the_rotors_own() -> None:
    places = np.cumsum(np.random.default_rng(1).standard_normal(300))
    places -= places[0]
    turned = [0.0, *map(Rotor(100.0, 0.2, 1e-3).step, places[:-1].tolist(), places[1:].tolist())]
    command = ActuatorInput(places, 1e-3, held=False)
    assert respond(STIFF, command, np.arange(300) * 1e-3) == pytest.approx(turned, abs=1e-9)


@pytest.mark.parametrize(
    ("model", "held", "dwell", "tick_s", "colour", "least"),
    [
        (TABLE_4, True, (50, 200), 0.01, 0.0, 0.92),
        (STIFF, False, (60, 150), 1e-3, 0.0, 0.92),
        (STIFF, False, (60, 150), 1e-3, 0.7, 0.85),
    ],
    ids=["table 4", "stiff", "stiff, noise through a filter"],
)
def test_true_values_lie_within_the_stated_intervals(
    model: SecondOrderModel,
    held: bool,
    dwell: tuple[int, int],
    tick_s: float,
    colour: float,
    least: float,
) -> None:
    late = replace(model, latency_s=4.3 * tick_s)
    inside = [
        trial(late, stairs(1000, dwell, seed, held, tick_s), 0.05, seed, colour)[1]
        for seed in range(TRIALS)
    ]
    assert np.mean(inside) >= least


@pytest.mark.parametrize("late_ticks", [0.0, 0.4, 7.9])
@pytest.mark.parametrize("model", [TABLE_4, STIFF], ids=["table 4", "stiff"])
def test_the_latency_is_found_within_a_fifth_of_a_tick(
    model: SecondOrderModel, late_ticks: float
) -> None:
    slow = model is TABLE_4
    tick_s = 0.01 if slow else 1e-3
    command = stairs(1000, (50, 200) if slow else (60, 150), 1, held=slow, tick_s=tick_s)
    late = replace(model, latency_s=late_ticks * tick_s)
    found, _ = trial(late, command, 2e-3, seed=1)
    assert found.model.latency_s / tick_s == pytest.approx(late_ticks, abs=0.2)
    assert found.undetermined == ()
    assert found.zero_n == pytest.approx(0.1, abs=0.01)


def test_parameters_that_the_record_does_not_determine_are_named() -> None:
    quick = SecondOrderModel(1e-9, 2e-5, 1.0, latency_s=3e-3)
    found, _ = trial(quick, stairs(1000, (60, 150), 1, held=False, tick_s=1e-3), 0.02, seed=1)
    assert "m" in found.undetermined
    assert found.delay_s == pytest.approx(3e-3, abs=2e-4)
    drowned, _ = trial(STIFF, stairs(300, (60, 150), 1, held=False, tick_s=1e-3), 5.0, seed=1)
    assert drowned.nrmse > 0.5
    assert drowned.undetermined


def test_a_record_in_which_nothing_moves_is_refused() -> None:
    command, at_s = stairs(400, (60, 90), 1, held=False, tick_s=1e-3), np.arange(400) * 1e-3
    with pytest.raises(BenchError, match="the film does not change"):
        identify(command, at_s, np.zeros(400), 0.02)
    with pytest.raises(BenchError, match="the command does not change"):
        identify(ActuatorInput(np.zeros(400), 1e-3, held=False), at_s, at_s, 0.02)
    with pytest.raises(BenchError, match="at least 50"):
        identify(command, at_s[:49], at_s[:49], 0.02)
    with pytest.raises(BenchError, match="change `inverted` of the drive"):
        identify(command, at_s, -respond(STIFF, command, at_s), 0.02)


def test_a_step_response_is_the_textbooks() -> None:
    damping = 0.2
    _, ring, settling_s = step_response(replace(STIFF, latency_s=0.005))
    textbook = math.exp(-math.pi * damping / math.sqrt(1 - damping**2))
    assert ring == pytest.approx(textbook, abs=0.002)
    assert 0.025 < settling_s < 0.005 + 4.5 / (damping * 200 * math.pi)
    rise_s, overshoot, _ = step_response(SecondOrderModel(1e-8, 0.01, 1.0))
    assert overshoot == 0.0
    assert rise_s == pytest.approx(0.01 * math.log(9), rel=0.02)
