"""Integration methods for the paper's actuator, eq 22, under a voltage held over each tick.

m f'' + c f' + k f = u, at first at rest. Each function returns a stepper: it takes a voltage in V
and returns the force in N at the tick's end. Steppers that are written out here also work in
decimals, so that a reference can have any number of digits. Steppers of libraries call the library
once per tick with their (force, rate), as a closed loop requires.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from decimal import Decimal, getcontext
from typing import Generic, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.plant.scene import SecondOrderScene
from display_node.plant.second_order import SecondOrder
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.paper.explicit_loop import Number, Step
from telepulse.paper.published import ACTUATOR

Floats = NDArray[np.float64]


class Plant(NamedTuple, Generic[Number]):
    """The parameters of eq 22: m in kg, c in N·s/m, k in N/m, as printed."""

    m: Number
    c: Number
    k: Number


def explicit_euler(plant: Plant[Number], tick_s: Number, substeps: int) -> Step[Number]:
    """Step force and rate by the slopes at the sub-step's beginning; order 1."""
    m, c, k = plant
    h = tick_s / substeps
    force = rate = tick_s * 0

    def step(volts: Number) -> Number:
        nonlocal force, rate
        for _ in range(substeps):
            force, rate = force + h * rate, rate + h * (volts - c * rate - k * force) / m
        return force

    return step


def semi_implicit_euler(plant: Plant[Number], tick_s: Number, substeps: int) -> Step[Number]:
    """Step the rate, then the force by the new rate; order 1, keeps an oscillation's energy."""
    m, c, k = plant
    h = tick_s / substeps
    force = rate = tick_s * 0

    def step(volts: Number) -> Number:
        nonlocal force, rate
        for _ in range(substeps):
            rate += h * (volts - c * rate - k * force) / m
            force += h * rate
        return force

    return step


def rk4(plant: Plant[Number], tick_s: Number, substeps: int) -> Step[Number]:
    """Step by the classical Runge-Kutta method; order 4."""
    m, c, k = plant
    h = tick_s / substeps
    half, sixth = h / 2, h / 6
    force = rate = tick_s * 0

    def step(volts: Number) -> Number:
        nonlocal force, rate
        for _ in range(substeps):
            slope1 = (volts - c * rate - k * force) / m
            rate2 = rate + half * slope1
            slope2 = (volts - c * rate2 - k * (force + half * rate)) / m
            rate3 = rate + half * slope2
            slope3 = (volts - c * rate3 - k * (force + half * rate2)) / m
            rate4 = rate + h * slope3
            slope4 = (volts - c * rate4 - k * (force + h * rate3)) / m
            force += sixth * (rate + 2 * (rate2 + rate3) + rate4)
            rate += sixth * (slope1 + 2 * (slope2 + slope3) + slope4)
        return force

    return step


def shipped(plant: Plant[float], tick_s: float) -> Step[float]:
    """Step as the display node does: `SecondOrder`, the exact zero-order hold in floats."""
    scene = SecondOrderScene(kind="second_order", m=plant.m, c=plant.c, k=plant.k)
    return SecondOrder(scene, tick_s).step


def exact_hold(plant: Plant[float], tick_s: float) -> Step[Decimal]:
    """Step decimals by the exact zero-order hold, in the decimal context's digits."""
    (a11, a12, b1), (a21, a22, b2), _ = held_matrix(plant, tick_s)
    force = rate = Decimal(0)

    def step(volts: Decimal) -> Decimal:
        nonlocal force, rate
        force, rate = (a11 * force + a12 * rate + b1 * volts, a21 * force + a22 * rate + b2 * volts)
        return force

    return step


def held_matrix(plant: Plant[float], tick_s: float) -> list[list[Decimal]]:
    """Return the 3 × 3 map of (force, rate, held voltage) over a tick, in the context's digits.

    The exponential of eq 22's matrix, by scaling and squaring of a Taylor series.
    """
    zero, m, c, k, h = decimals((0.0, *plant, tick_s))
    system = np.array([[zero, h, zero], [-k / m * h, -c / m * h, h / m], [zero] * 3], object)
    halvings = order = 0
    while abs(system).max() > 1:
        system = system / 2
        halvings += 1
    term = total = np.eye(3, dtype=object)
    smallest = Decimal(10) ** -(getcontext().prec + 10)
    while abs(term).max() > smallest:
        order += 1
        term = term @ system / order
        total = total + term
    for _ in range(halvings):
        total = total @ total
    held: list[list[Decimal]] = total.tolist()
    return held


Solver = Literal["RK45", "DOP853", "Radau"]


def solve_ivp_steps(plant: Plant[float], tick_s: float, method: Solver, rtol: float) -> Step[float]:
    """Call scipy's solve_ivp each tick; its absolute tolerance is `rtol` too."""
    from scipy.integrate import solve_ivp

    m, c, k = plant

    def advance(state: list[float], volts: float) -> Floats:
        def slopes(_: float, at: Floats) -> tuple[float, float]:
            return at[1], (volts - c * at[1] - k * at[0]) / m

        solved = solve_ivp(slopes, (0.0, tick_s), state, method=method, rtol=rtol, atol=rtol)
        return solved.y[:, -1]

    return _from_rest(advance)


def lsim_steps(plant: Plant[float], tick_s: float) -> Step[float]:
    """Call scipy's lsim each tick."""
    from scipy.signal import lsim

    system, times_s = _state_space(plant), [0.0, tick_s]
    return _from_rest(
        lambda state, volts: lsim(system, [volts, volts], times_s, state, interp=False)[2][-1]
    )


def control_steps(plant: Plant[float], tick_s: float) -> Step[float]:
    """Call python-control's forced_response each tick. Raises ImportError without it."""
    from control import forced_response, ss

    system, times_s = ss(*_state_space(plant)), [0.0, tick_s]
    return _from_rest(
        lambda state, volts: forced_response(system, times_s, [volts, volts], state).states[:, -1]
    )


def _from_rest(advance: Callable[[list[float], float], Floats]) -> Step[float]:
    """Return the stepper that advances (force, rate) by a library's function."""
    state: list[float] = [0.0, 0.0]

    def step(volts: float) -> float:
        nonlocal state
        state = advance(state, volts).tolist()
        return state[0]

    return step


def _state_space(plant: Plant[float]) -> tuple[Floats, Floats, Floats, Floats]:
    """Return A, B, C, D of eq 22 with the state (force, rate)."""
    m, c, k = plant
    slopes, gains = np.array([[0, 1], [-k / m, -c / m]]), np.array([[0], [1 / m]])
    return slopes, gains, np.array([[1.0, 0]]), np.array([[0.0]])


PAPER_PLANT = Plant(ACTUATOR.m, ACTUATOR.c, ACTUATOR.k)
"""Table 4 and eq 22."""


def pulse_from_rest(scene: SyntheticScene, seconds: float, tick_s: float) -> list[float]:
    """Return a synthetic pulse once a tick, in N above its first sample, which is at rest."""
    source = SyntheticSource(scene.model_copy(update={"rate_hz": 1 / tick_s}))
    force_n = source.take(round(seconds / tick_s))[:, 0]
    risen_n: list[float] = (force_n - force_n[0]).tolist()
    return risen_n


def decimals(numbers: Iterable[float]) -> list[Decimal]:
    """Convert floats to decimals, digit for digit."""
    return [Decimal(number) for number in numbers]


def largest_error(forces_n: Sequence[Decimal], truth_n: Sequence[Decimal]) -> float:
    """Return the largest difference in N; infinite where a trajectory overflowed."""
    if not all(force_n.is_finite() for force_n in forces_n):
        return math.inf
    return float(max(abs(a - b) for a, b in zip(forces_n, truth_n, strict=True)))
