"""The force loop as a linear system, obtained by running the loop's own objects.

Each part is put into each of its states in turn and run for one tick; the result is a column of
the system's matrices. What is not linear is left out: microsteps, backlash, limits, the film's
noise and converter, the curve of the contact law. An observer has its stationary gains.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from display_node.control.controller import ControllerScene, StepperController, VoltageController
from display_node.control.observer import DESIGN_FORCE_N, observer_gains
from display_node.plant.contact import LinearContact
from display_node.plant.film import FeedbackFilm, FilmTable
from display_node.plant.second_order import SecondOrder, SecondOrderScene
from display_node.plant.stepper import Stepper, StepperScene
from protocol.tactile import ElasticLayer

Array = NDArray[np.float64]
# Size of each state and input in turn. A power of two scales without rounding; so small, no bound
# of an observer's states is met.
PROBE = 2.0**-40


class Stateful(Protocol):
    """A part of the loop."""

    @property
    def STATE(self) -> tuple[str, ...]:  # noqa: N802
        """Names of the attributes that one tick hands on to the next.

        Numbers, sequences of numbers, or parts with states of their own; None is no state.
        """


@dataclass(frozen=True, slots=True)
class LinearLoop:
    """A loop of n states, cut where its output enters the plant; the reference is zero.

    Lengths are in m of tip travel (a stepper) or in N (eq 22).

    Attributes
    ----------
    a
        Shape (n, n): the next state, from the state.
    b
        Shape (n,): the next state, from an input to the plant.
    c
        Shape (n,): the controller's output, from the state.
    noise
        Shape (n,): the next state, from an error of the reading.
    through
        The output, from an error of the reading.
    tip
        Shape (n,): the tip, from the state.
    displaced
        Shape (n,): the state in which the finger has just moved by 1 against the tip.
    counts
        Number of positions that the controller counts by itself beside the plant's. Each makes a
        pole at 1, the constant that plant and count differ by, which the loop rejects.
    """

    tick_s: float
    a: Array
    b: Array
    c: Array
    noise: Array
    through: float
    tip: Array
    displaced: Array
    counts: int = 0

    @property
    def closed(self) -> Array:
        """Shape (n, n): the closed loop, from tick to tick."""
        return self.a + np.outer(self.b, self.c)

    @property
    def closed_noise(self) -> Array:
        """Shape (n,): the closed loop's next state, from an error of the reading."""
        return self.noise + self.b * self.through

    def poles(self) -> NDArray[np.complex128]:
        """Return the complex poles of the closed loop, without those of `counts`."""
        poles = np.linalg.eigvals(self.closed).astype(np.complex128)
        return poles[np.argsort(np.abs(poles - 1))][self.counts :]


def linear_loop(
    controller: ControllerScene,
    actuator: SecondOrderScene | StepperScene,
    layer: ElasticLayer,
    film: FilmTable,
    tick_s: float,
    force_n: float,
) -> LinearLoop:
    """Return the loop that `build_force_loop` builds, linear round a force in N."""
    reading = FeedbackFilm(film.model_copy(update={"noise_n": 0.0, "adc_bits": None}), tick_s)
    gains = controller.model_copy(update={"dead_band": 0.0})
    if isinstance(actuator, SecondOrderScene):
        free = actuator.model_copy(update={"voltage_limit": np.inf})
        return _Probe(
            VoltageController(gains, free, film, tick_s), SecondOrder(free, tick_s), reading
        ).linear(tick_s)
    contact = actuator.contact(layer)
    stiffness = 1.0 if controller.error == "position" else contact.stiffness(force_n)
    unbounded = {"max_speed_m_per_s": np.inf, "backlash_m": 0.0}
    endless = actuator.model_copy(update=unbounded)
    observer = controller.observer
    fixed = None
    if observer is not None:
        per_m = contact.stiffness(DESIGN_FORCE_N)
        step_n = actuator.step_m * per_m / np.sqrt(12)
        fixed = observer_gains(film, observer.wander_m * per_m, step_n, tick_s)
    law = LinearContact(stiffness)
    return _Probe(
        StepperController(gains, endless, law, film, np.inf, tick_s, observer_gains=fixed),
        Stepper(endless, law, np.inf, tick_s, linear=True),
        reading,
        stiffness,
        endless.step_rate().rate_hz(1.0),
    ).linear(tick_s, counts=int(observer is not None))


class _Probe:
    """The running parts of a loop, put into one state after the other."""

    def __init__(
        self,
        controller: StepperController | VoltageController,
        plant: Stepper | SecondOrder,
        film: FeedbackFilm,
        stiffness_n: float = 1.0,
        hz_per_output: float = 1.0,
    ) -> None:
        self._controller, self._plant, self._film = controller, plant, film
        self._stiffness_n = stiffness_n
        self._hz_per_output = hz_per_output
        self._reference_n = [0.0] * (controller.horizon + 1)
        self._parts: tuple[Stateful, ...] = (plant, film, controller)
        # The first tick makes states of what begins as None.
        self._tick()

    @property
    def _tip(self) -> float:
        return self._plant.tip_m if isinstance(self._plant, Stepper) else self._plant.force_n

    def _tick(self, push: float = 0.0, noise: float = 0.0) -> float:
        """Run a tick of the loop cut, the plant under a push alone; return the output."""
        reading_n = self._film.read(self._stiffness_n * self._tip) + self._stiffness_n * noise
        output = self._controller.output(self._reference_n, reading_n)
        self._plant.step(push * self._hz_per_output)
        return output

    def _read(self) -> Array:
        return np.array([value for part in self._parts for value in _states(part)])

    def _write(self, values: Array) -> None:
        left = iter(values.tolist())
        for part in self._parts:
            _set_states(part, left)

    def linear(self, tick_s: float, counts: int = 0) -> LinearLoop:
        """Return the linear loop."""
        at_rest = np.zeros(len(self._read()))

        def column(state: Array, push: float = 0.0, noise: float = 0.0) -> tuple[Array, float]:
            self._write(PROBE * state)
            output = self._tick(PROBE * push, PROBE * noise)
            return self._read() / PROBE, output / PROBE

        tip = []
        for state in np.eye(len(at_rest)):
            self._write(state)
            tip.append(self._tip)
        columns = [column(state) for state in np.eye(len(at_rest))]
        noise, through = column(at_rest, noise=1.0)
        pushed, _ = column(at_rest, push=1.0)
        self._write(at_rest)
        self._plant.place(1.0)
        return LinearLoop(
            tick_s,
            a=np.array([after for after, _ in columns]).T,
            b=pushed,
            c=np.array([output for _, output in columns]),
            noise=noise,
            through=through,
            tip=np.array(tip),
            displaced=self._read(),
            counts=counts,
        )


def _states(part: Stateful) -> Iterator[float]:
    for name in part.STATE:
        value = getattr(part, name)
        if value is None:
            continue
        if hasattr(value, "STATE"):
            yield from _states(value)
        elif isinstance(value, float):
            yield value
        else:
            yield from value


def _set_states(part: Stateful, values: Iterator[float]) -> None:
    for name in part.STATE:
        value = getattr(part, name)
        if value is None:
            continue
        if hasattr(value, "STATE"):
            _set_states(value, values)
        elif isinstance(value, float):
            setattr(part, name, next(values))
        else:
            for index in range(len(value)):
                value[index] = next(values)
