"""The force loop as a linear system, for its poles and margins.

The same equations as `controller`, `observer`, `pid` and the actuators, at rest round one
force, with everything in metres of tip travel (a stepper) or newtons (second order). What is
not linear is left out: microsteps, play, limits, the curve of the contact law.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from display_node.control.controller import ControllerScene
from display_node.control.observer import DESIGN_FORCE_N, observer_gains
from display_node.plant.film import FilmTable
from display_node.plant.second_order import SecondOrder, SecondOrderScene
from display_node.plant.stepper import Rotor, StepperScene
from protocol.tactile import ElasticLayer

Array = NDArray[np.float64]
# (states, input) → (output, next states)
Run = Callable[[Array, float], tuple[float, Array]]


@dataclass(frozen=True, slots=True)
class LinearPlant:
    """Actuator and film: `read` gives the reading of a state, `move` the next state.

    displaced: the state in which the finger has just moved by 1 against the tip.
    """

    displaced: Array
    read: Callable[[Array], float]
    tip: Callable[[Array], float]
    move: Callable[[Array, float], Array]

    @property
    def states(self) -> int:
        """How many states actuator and film have."""
        return len(self.displaced)


@dataclass(frozen=True, slots=True)
class Law:
    """A controller: `decide` gives the output and the next state, from a state and a reading.

    counts: the number of positions it counts by itself beside the plant's. Each makes a pole
    at 1, the constant that plant and count differ by, which the loop rejects.
    """

    states: int
    decide: Callable[[Array, float], tuple[float, Array]]
    counts: int = 0


@dataclass(frozen=True, slots=True)
class LinearLoop:
    """Plant and controller joined; the reference is zero."""

    plant: LinearPlant
    law: Law
    tick_s: float

    def step(self, state: Array, push: float, noise: float = 0.0, closed: bool = True) -> Array:
        """One tick: the next state and, as its last entry, the controller's output.

        push: added to the output on its way to the plant, where the loop is closed, or in its
        stead where it is cut; noise: what the reading is off by.
        """
        n = self.plant.states
        reading = self.plant.read(state[:n]) + noise
        output, law_state = self.law.decide(state[n:], reading)
        moved = self.plant.move(state[:n], push + (output if closed else 0.0))
        return np.concatenate([moved, law_state, [output]])

    @property
    def states(self) -> int:
        """How many states plant and controller have."""
        return self.plant.states + self.law.states

    def closed(self) -> Array:
        """Matrix of the closed loop, from tick to tick."""
        return _matrix(lambda state: self.step(state, 0.0)[:-1], self.states)

    def poles(self) -> NDArray[np.complex128]:
        """Poles of the closed loop, complex, without those of `Law.counts`."""
        poles = np.linalg.eigvals(self.closed()).astype(np.complex128)
        return poles[np.argsort(np.abs(poles - 1))][self.law.counts :]

    def cut(self) -> tuple[Array, Array, Array]:
        """Matrices (A, B, C) of the loop cut where its output enters the plant."""
        n = self.states
        both = _matrix(lambda state: self.step(state, 0.0, closed=False), n)
        pushed = self.step(np.zeros(n), 1.0, closed=False)
        return both[:-1], pushed[:-1, None], both[-1:]


def linear_loop(
    controller: ControllerScene,
    actuator: SecondOrderScene | StepperScene,
    layer: ElasticLayer,
    film: FilmTable,
    tick_s: float,
    force_n: float,
) -> LinearLoop:
    """The loop that `force_loop.build_force_loop` builds, linear round a force."""
    if isinstance(actuator, SecondOrderScene):
        plant = _second_order_plant(actuator, film, tick_s)
        return LinearLoop(plant, _voltage_law(controller, actuator, film, tick_s), tick_s)
    contact = actuator.contact(layer)
    plant = _stepper_plant(actuator, film, tick_s)
    late_ticks = actuator.ticks_to_reading(film.latency_ns, tick_s)
    if controller.observer is not None:
        stiffness = contact.stiffness(DESIGN_FORCE_N)
        gains = observer_gains(
            film,
            controller.observer.wander_m * stiffness,
            actuator.step_m * stiffness / np.sqrt(12),
            tick_s,
        )
        at_once = actuator.model_copy(update={"latency_ns": 0})
        twin = _stepper_plant(at_once, film, tick_s)
        law = _observer_law(controller, twin, film, late_ticks, gains, tick_s)
        return LinearLoop(plant, law, tick_s)
    unit = 1.0
    if controller.error != "position":
        unit = contact.stiffness(force_n)
    if controller.error == "millivolts":
        unit *= film.millivolts_per_newton
    pid = _pid(controller, tick_s)

    def decide(state: Array, reading: float) -> tuple[float, Array]:
        return pid(state, -unit * reading, unit * tick_s)

    return LinearLoop(plant, Law(3, decide), tick_s)


def _pid(
    scene: ControllerScene, tick_s: float
) -> Callable[[Array, float, float], tuple[float, Array]]:
    """`pid.Pid.step` without its bounds; states: integral, derivative, last error."""
    filter_s = 1 / (2 * np.pi * scene.derivative_filter_hz)
    keep, kd_tick = filter_s / (filter_s + tick_s), scene.kd / (filter_s + tick_s)
    ki_tick = scene.ki * tick_s
    gain = scene.kp + ki_tick + kd_tick
    # What nothing feeds is no state; left in, an integral would be a pole at 1.
    kept = 1.0 if scene.ki else 0.0
    keep = keep if scene.kd else 0.0

    def step(state: Array, error: float, response: float) -> tuple[float, Array]:
        integral, derivative, last = state
        past = integral + keep * derivative - kd_tick * last
        output = (gain * error + past) / (1 + response * gain)
        remaining = error - response * output
        change = kd_tick * (remaining - last)
        return output, np.array(
            [kept * integral + ki_tick * remaining, keep * derivative + change, remaining]
        )

    return step


def _filtered(film: FilmTable, tick_s: float) -> tuple[int, Run]:
    """Number of the film filter's states, and a function (states, input) → (output, states)."""
    low_pass = film.low_pass(tick_s)
    if low_pass is None:
        return 0, lambda state, value: (value, state)

    def run(state: Array, value: float) -> tuple[float, Array]:
        output = float(low_pass.c[0] @ state) + float(low_pass.d[0, 0]) * value
        return output, low_pass.a @ state + low_pass.b[:, 0] * value

    return film.filter_order, run


def _late(ticks: float) -> tuple[int, Run]:
    """`delay.Delay`; states: what it was given before, the newest last."""
    if not ticks:
        return 0, lambda state, value: (value, state)
    whole = int(ticks)
    part = ticks - whole

    def run(state: Array, value: float) -> tuple[float, Array]:
        past = np.append(state, value)
        return float(past[1] + part * (past[0] - past[1])), past[1:]

    return whole + 1, run


def _read(film: FilmTable, tick_s: float) -> tuple[int, Run]:
    """`film.FeedbackFilm` without noise and converter; states: delay, filter."""
    waits, wait = _late(film.latency_ns * 1e-9 / tick_s)
    filters, run = _filtered(film, tick_s)

    def read(state: Array, value: float) -> tuple[float, Array]:
        value, waiting = wait(state[:waits], value)
        output, filtered = run(state[waits:], value)
        return output, np.concatenate([waiting, filtered])

    return waits + filters, read


def _stepper_plant(scene: StepperScene, film: FilmTable, tick_s: float) -> LinearPlant:
    """States: screw, rotor position and speed, commands on their way, film."""
    waits, wait = _late(scene.latency_ns * 1e-9 / tick_s)
    films, read = _read(film, tick_s)
    first = 3 + waits
    rotor = None
    if scene.rotor_resonance_hz is not None:
        rotor = Rotor(scene.rotor_resonance_hz, scene.rotor_damping, tick_s).matrix

    def tip(state: Array) -> float:
        return float(state[0] if rotor is None else state[1])

    def move(state: Array, speed: float) -> Array:
        speed, waiting = wait(state[3:first], speed)
        travel = tick_s * speed
        turned = np.zeros(2)
        if rotor is not None:
            turned = rotor @ np.array([state[1], state[2], state[0], travel])
        read_on = read(state[first:], tip(state))[1]
        return np.concatenate([[state[0] + travel], turned, waiting, read_on])

    displaced = np.array([1.0, 0.0 if rotor is None else 1.0, 0.0] + [0.0] * (waits + films))
    return LinearPlant(displaced, lambda state: read(state[first:], tip(state))[0], tip, move)


def _observer_law(
    scene: ControllerScene,
    twin: LinearPlant,
    film: FilmTable,
    late_ticks: float,
    gains: tuple[float, list[float]],
    tick_s: float,
) -> Law:
    """States: offset, twin's actuator, its places that are still to be read, filter, PID."""
    waits, wait = _late(late_ticks)
    filters, run = _filtered(film, tick_s)
    first, last = 4 + waits, 4 + waits + filters
    pid = _pid(scene, tick_s)
    offset_gain, filter_gains = gains[0], np.array(gains[1])

    def decide(state: Array, reading: float) -> tuple[float, Array]:
        offset, moved = state[0], state[1:4]
        place, waiting = wait(state[4:first], twin.tip(moved))
        expected, filtered = run(state[first:last], place + offset)
        error = reading - expected
        offset = offset + offset_gain * error
        output, pid_state = pid(state[last:], -(moved[0] + offset), tick_s)
        moved = twin.move(np.concatenate([moved, np.zeros(twin.states - 3)]), output)[:3]
        filtered = filtered + filter_gains * error
        return output, np.concatenate([[offset], moved, waiting, filtered, pid_state])

    return Law(last + 3, decide, counts=1)


def _second_order_plant(scene: SecondOrderScene, film: FilmTable, tick_s: float) -> LinearPlant:
    """States: force, its rate, film."""
    films, read = _read(film, tick_s)
    held = SecondOrder(scene, tick_s).matrix

    def move(state: Array, volts: float) -> Array:
        moved = held @ np.array([state[0], state[1], volts])
        return np.concatenate([moved, read(state[2:], state[0])[1]])

    return LinearPlant(
        np.array([1.0] + [0.0] * (1 + films)),
        lambda state: read(state[2:], state[0])[0],
        lambda state: float(state[0]),
        move,
    )


def _voltage_law(
    scene: ControllerScene, actuator: SecondOrderScene, film: FilmTable, tick_s: float
) -> Law:
    """States: the twin's rate of force, PID."""
    held = SecondOrder(actuator, tick_s).matrix
    unit = film.millivolts_per_newton if scene.error == "millivolts" else 1.0
    pid = _pid(scene, tick_s)

    def decide(state: Array, reading: float) -> tuple[float, Array]:
        free = held[0, 0] * reading + held[0, 1] * state[0]
        volts, pid_state = pid(state[1:], -unit * free, unit * held[0, 2])
        rate = held[1] @ np.array([reading, state[0], volts])
        return volts, np.concatenate([[rate], pid_state])

    return Law(4, decide)


def _matrix(step: Callable[[Array], Array], states: int) -> Array:
    """The matrix of a linear function, column by column."""
    return np.array([step(column) for column in np.eye(states)]).T
