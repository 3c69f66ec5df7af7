"""What libraries offer to step eq 22, each called once a tick as a loop needs it.

A stepper keeps (force, rate) and hands it to the library with the held voltage.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from telepulse.reports.studies.integrators import Plant, Step

Solver = Literal["RK45", "DOP853", "Radau"]
Matrices = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def solve_ivp_steps(plant: Plant[float], tick_s: float, method: Solver, rtol: float) -> Step[float]:
    """A call of scipy's solve_ivp each tick; its absolute tolerance is `rtol` too."""
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
    """A call of scipy's lsim each tick."""
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
    """A call of python-control's forced_response each tick. Raises ImportError without it."""
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
    """One lsim call for a whole row of voltages known beforehand: the force after each tick."""
    from scipy.signal import lsim

    held = [*voltages, voltages[-1]]
    times_s = np.arange(len(held)) * tick_s
    force_n: list[float] = lsim(_state_space(plant), held, times_s, interp=False)[1][1:].tolist()
    return force_n


def _state_space(plant: Plant[float]) -> Matrices:
    """A, B, C, D of eq 22 with the state (force, rate)."""
    m, c, k = plant.m, plant.c, plant.k
    return (
        np.array([[0, 1], [-k / m, -c / m]]),
        np.array([[0], [1 / m]]),
        np.array([[1.0, 0]]),
        np.array([[0.0]]),
    )
