"""Integrators on a rotor that resonates at 100 Hz, voltages held over ticks of 1 ms."""

import math
from collections.abc import Callable
from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.linalg import expm

from sensing_node.sources.synthetic import SyntheticScene
from telepulse.paper.explicit_loop import Step, close_loop
from telepulse.reports.studies.integrators import (
    PAPER_PLANT,
    Plant,
    Solver,
    control_steps,
    decimals,
    exact_hold,
    explicit_euler,
    held_matrix,
    largest_error,
    lsim_steps,
    lsim_whole,
    pulse_from_rest,
    rk4,
    semi_implicit_euler,
    shipped,
    solve_ivp_steps,
)

TICK_S = 1e-3
OMEGA = 2 * math.pi * 100
VOLTAGES = (OMEGA**2 * np.random.default_rng(4).normal(0, 1, 60)).tolist()


def rotor(damping: float) -> Plant[float]:
    return Plant(1.0, 2 * damping * OMEGA, OMEGA**2)


def truth(plant: Plant[float], digits: int = 40) -> list[Decimal]:
    with localcontext(prec=digits):
        step = exact_hold(plant, TICK_S)
        return [step(volts) for volts in decimals(VOLTAGES)]


def error(step: Step[float], plant: Plant[float]) -> float:
    return largest_error(decimals(map(step, VOLTAGES)), truth(plant))


@pytest.mark.parametrize("damping", [0.0, 0.2, 0.99])
def test_the_reference_is_the_step_response_of_theory(damping: float) -> None:
    plant = rotor(damping)
    with localcontext(prec=40):
        forces = list(map(exact_hold(plant, TICK_S), decimals([plant.k]) * 50))
    t_s = TICK_S * np.arange(1, 51)
    decay, swing = damping * OMEGA, OMEGA * math.sqrt(1 - damping**2)
    expected = 1 - np.exp(-decay * t_s) * (
        np.cos(swing * t_s) + decay / swing * np.sin(swing * t_s)
    )
    assert [float(force) for force in forces] == pytest.approx(expected.tolist(), abs=1e-12)


@pytest.mark.parametrize("tick_s", [1e-4, 1e-3, 1e-2])
def test_the_held_matrix_is_the_exponential(tick_s: float) -> None:
    plant = rotor(0.2)
    held = held_matrix(plant, tick_s)
    system = np.array([[0, 1, 0], [-plant.k, -plant.c, 1], [0, 0, 0]]) * tick_s
    assert np.array(held, dtype=float) == pytest.approx(expm(system), rel=1e-11, abs=1e-14)


@pytest.mark.parametrize("damping", [0.0, 0.001, 0.2, 1.0, 3.0])
def test_the_exact_integrators_are_exact_whatever_the_damping(damping: float) -> None:
    plant = rotor(damping)
    assert largest_error(truth(plant, 60), truth(plant, 40)) < 1e-35
    assert error(shipped(plant, TICK_S), plant) < 1e-13
    assert error(lsim_steps(plant, TICK_S), plant) < 1e-12
    assert error(control_steps(plant, TICK_S), plant) < 1e-12
    whole = lsim_whole(plant, TICK_S, VOLTAGES)
    assert largest_error(decimals(whole), truth(plant)) < 1e-12


@pytest.mark.parametrize(
    ("stepper", "order", "substeps"),
    [(explicit_euler, 1, 256), (semi_implicit_euler, 1, 256), (rk4, 4, 16)],
)
def test_each_doubling_of_sub_steps_gains_the_order_in_bits(
    stepper: Callable[[Plant[float], float, int], Step[float]], order: int, substeps: int
) -> None:
    plant = rotor(0.2)
    errors = [
        error(stepper(plant, TICK_S, n), plant) for n in (substeps, 2 * substeps, 4 * substeps)
    ]
    slopes = -np.diff(np.log2(errors))
    assert slopes == pytest.approx([order, order], abs=0.05)


def test_the_explicit_method_grows_where_the_semi_implicit_does_not() -> None:
    plant = rotor(0.001)
    assert error(explicit_euler(plant, TICK_S, 1), plant) > 1e3
    assert error(semi_implicit_euler(plant, TICK_S, 1), plant) < 10
    beyond_floats = decimals(map(explicit_euler(plant, 1.0, 1), [1.0] * 200))
    assert largest_error(beyond_floats, [Decimal(0)] * 200) == math.inf


@pytest.mark.parametrize("solver", ["RK45", "DOP853", "Radau"])
def test_solve_ivp_keeps_its_tolerance(solver: Solver) -> None:
    plant = rotor(0.2)
    assert error(solve_ivp_steps(plant, TICK_S, solver, 1e-8), plant) < 1e-6


SCENE = SyntheticScene.model_validate({"kind": "synthetic", "preset": "paper"})


def test_the_pulse_begins_at_rest_and_has_the_scenes_height() -> None:
    for tick_s, ticks in ((1e-4, 20_000), (1e-3, 2_000)):
        pulse_n = pulse_from_rest(SCENE, 2.0, tick_s)
        assert (len(pulse_n), pulse_n[0]) == (ticks, 0.0)
        assert np.ptp(pulse_n) == pytest.approx(SCENE.peak_to_peak_n, rel=1e-3)


def test_the_loop_in_decimals_is_the_loop_in_floats() -> None:
    pulse_n = pulse_from_rest(SCENE, 0.5, 1e-3)
    forces_n, voltages = close_loop(shipped(PAPER_PLANT, 1e-3), 1e-3, pulse_n)
    with localcontext(prec=40):
        exact_n, exact_volts = close_loop(exact_hold(PAPER_PLANT, 1e-3), 1e-3, decimals(pulse_n))
    assert forces_n == pytest.approx([float(force) for force in exact_n], abs=1e-14)
    assert voltages == pytest.approx([float(volts) for volts in exact_volts], abs=1e-8)
