"""Integration methods for the paper's actuator, eq 22, under a voltage held over each tick.

m f'' + c f' + k f = u, at rest at first. Each function returns a stepper: it takes a voltage in V
and returns the force in N at the tick's end. Those written out here work in floats and in decimals
alike, so that a reference can have as many digits as it needs. Those of libraries call the library
once a tick with their (force, rate), as a closed loop must.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal, getcontext
from typing import Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from display_node.plant.second_order import SecondOrder, SecondOrderScene

Number = TypeVar("Number", float, Decimal)
Step = Callable[[Number], Number]
Matrix = list[list[Decimal]]


@dataclass(frozen=True, slots=True)
class Plant(Generic[Number]):
    """The parameters of eq 22: m in kg, c in N·s/m, k in N/m, as printed."""

    m: Number
    c: Number
    k: Number


def explicit_euler(plant: Plant[Number], tick_s: Number, substeps: int) -> Step[Number]:
    """Step force and rate by the slopes at the sub-step's beginning; order 1."""
    m, c, k = plant.m, plant.c, plant.k
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
    m, c, k = plant.m, plant.c, plant.k
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
    m, c, k = plant.m, plant.c, plant.k
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


def exact_hold(plant: Plant[Decimal], tick_s: Decimal) -> Step[Decimal]:
    """Step by the exact zero-order hold in the decimal context's digits."""
    (a11, a12, b1), (a21, a22, b2) = held_matrix(plant, tick_s)[:2]
    force = rate = Decimal(0)

    def step(volts: Decimal) -> Decimal:
        nonlocal force, rate
        force, rate = (a11 * force + a12 * rate + b1 * volts, a21 * force + a22 * rate + b2 * volts)
        return force

    return step


def held_matrix(plant: Plant[Decimal], tick_s: Decimal) -> Matrix:
    """Return the 3 × 3 map of (force, rate, held voltage) over a tick, in the context's digits.

    The exponential of eq 22's matrix, by scaling and squaring of a Taylor series.
    """
    zero = Decimal(0)
    system = [
        [zero, tick_s, zero],
        [-plant.k / plant.m * tick_s, -plant.c / plant.m * tick_s, tick_s / plant.m],
        [zero, zero, zero],
    ]
    halvings = 0
    while max(abs(x) for row in system for x in row) > 1:
        system = [[x / 2 for x in row] for row in system]
        halvings += 1
    term = total = [[Decimal(int(i == j)) for j in range(3)] for i in range(3)]
    smallest = Decimal(10) ** -(getcontext().prec + 10)
    order = 0
    while max(abs(x) for row in term for x in row) > smallest:
        order += 1
        term = [[x / order for x in row] for row in _product(term, system)]
        total = [[total[i][j] + term[i][j] for j in range(3)] for i in range(3)]
    for _ in range(halvings):
        total = _product(total, total)
    return total


def _product(a: Matrix, b: Matrix) -> Matrix:
    columns = list(zip(*b, strict=True))
    return [
        [sum((x * y for x, y in zip(row, column, strict=True)), Decimal(0)) for column in columns]
        for row in a
    ]


Solver = Literal["RK45", "DOP853", "Radau"]
Matrices = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def solve_ivp_steps(plant: Plant[float], tick_s: float, method: Solver, rtol: float) -> Step[float]:
    """Call scipy's solve_ivp each tick; its absolute tolerance is `rtol` too."""
    from scipy.integrate import solve_ivp

    m, c, k = plant.m, plant.c, plant.k
    state = [0.0, 0.0]

    def step(volts: float) -> float:
        nonlocal state

        def slopes(_: float, at: NDArray[np.float64]) -> tuple[float, float]:
            return at[1], (volts - c * at[1] - k * at[0]) / m

        solved = solve_ivp(slopes, (0.0, tick_s), state, method=method, rtol=rtol, atol=rtol)
        state = solved.y[:, -1].tolist()
        return float(state[0])

    return step


def lsim_steps(plant: Plant[float], tick_s: float) -> Step[float]:
    """Call scipy's lsim each tick."""
    from scipy.signal import lsim

    system = _state_space(plant)
    times_s, state = [0.0, tick_s], [0.0, 0.0]

    def step(volts: float) -> float:
        nonlocal state
        _, _, states = lsim(system, [volts, volts], times_s, state, interp=False)
        state = states[-1].tolist()
        return float(state[0])

    return step


def control_steps(plant: Plant[float], tick_s: float) -> Step[float]:
    """Call python-control's forced_response each tick. Raises ImportError without it."""
    import control

    system = control.ss(*_state_space(plant))
    times_s, state = [0.0, tick_s], [0.0, 0.0]

    def step(volts: float) -> float:
        nonlocal state
        response = control.forced_response(system, times_s, [volts, volts], state)
        state = response.states[:, -1].tolist()
        return float(state[0])

    return step


def lsim_whole(plant: Plant[float], tick_s: float, voltages: Sequence[float]) -> list[float]:
    """Return the force after each tick of voltages known beforehand, by one call of lsim."""
    from scipy.signal import lsim

    held = [*voltages, voltages[-1]]
    times_s = np.arange(len(held)) * tick_s
    force_n: list[float] = lsim(_state_space(plant), held, times_s, interp=False)[1][1:].tolist()
    return force_n


def _state_space(plant: Plant[float]) -> Matrices:
    """Return A, B, C, D of eq 22 with the state (force, rate)."""
    m, c, k = plant.m, plant.c, plant.k
    return (
        np.array([[0, 1], [-k / m, -c / m]]),
        np.array([[0], [1 / m]]),
        np.array([[1.0, 0]]),
        np.array([[0.0]]),
    )
