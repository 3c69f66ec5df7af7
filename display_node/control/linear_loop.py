"""The force loop as a linear system: poles, margins, and its response to noise.

Each state variable of the loop's own objects is set in turn, and the loop is run for one tick; the
result is a column of the system's matrices. Nonlinear parts are left out: microsteps, backlash,
limits, the film's noise and ADC, the curve of the contact law. An observer has stationary gains.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from display_node.control.controller import StepperController, VoltageController
from display_node.control.observer import DESIGN_FORCE_N, observer_gains
from display_node.control.scene import ControllerScene
from display_node.plant.contact import LinearContact
from display_node.plant.film import FilmModel
from display_node.plant.scene import ActuatorScene, FilmTable, ForceModel
from display_node.plant.stepper import Stepper
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer

Array = NDArray[np.float64]
# Value to which states and inputs are set. A power of two scales without rounding, and one this
# small stays within the bounds of an observer's states.
PROBE = 2.0**-40


@dataclass(frozen=True, slots=True)
class LinearLoop:
    """A loop of n states, cut where its output enters the plant; the reference is zero.

    Lengths are in m of tip travel (a stepper) or in N (eq 22).

    Attributes
    ----------
    a, b
        Shapes (n, n) and (n,): next state per state, and per input to the plant.
    c, through
        Shape (n,) and a number: controller's output per state, and per error of the reading.
    noise
        Shape (n,): next state per error of the reading.
    tip
        Shape (n,): tip position per state.
    displaced
        Shape (n,): state in which the finger has just moved by 1 against the tip.
    counts
        Number of positions that the controller counts besides the plant's. Each makes a pole at 1,
        for a constant difference of plant and count, which the loop rejects.
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
    actuator: ActuatorScene,
    layer: ElasticLayer,
    film: FilmTable,
    tick_s: float,
    force_n: float,
) -> LinearLoop:
    """Return the loop that `build_force_loop` builds, linearised at a force in N."""
    reading = FilmModel(film.model_copy(update={"noise_n": 0.0, "adc_bits": None}), tick_s)
    gains = controller.model_copy(update={"dead_band": 0.0})
    stepper = actuator.stepper
    if stepper is None:
        voltage = VoltageController(gains, actuator.build(tick_s), np.inf, film, tick_s)
        return _linear(voltage, actuator.build(tick_s), reading, tick_s)
    contact = stepper.contact(layer)
    stiffness = 1.0 if controller.error == "position" else contact.stiffness(force_n)
    unbounded = {"max_speed_m_per_s": np.inf, "backlash_m": 0.0}
    endless = stepper.model_copy(update=unbounded)
    observer = controller.observer
    fixed = None
    if observer is not None:
        per_m = contact.stiffness(DESIGN_FORCE_N)
        step_n = stepper.step_m * per_m / np.sqrt(12)
        fixed = observer_gains(film, observer.wander_m * per_m, step_n, tick_s)
    law = LinearContact(stiffness)
    speed = StepperController(gains, endless, law, film, np.inf, tick_s, observer_gains=fixed)
    plant = Stepper(endless, law, np.inf, tick_s, linear=True)
    counts = int(observer is not None)
    return _linear(speed, plant, reading, tick_s, stiffness, counts)


def _linear(
    controller: StepperController | VoltageController,
    plant: Stepper | ForceModel,
    film: FilmModel,
    tick_s: float,
    stiffness_n: float = 1.0,
    counts: int = 0,
) -> LinearLoop:
    """Return the linear loop of these parts; their states are set one after the other."""
    parts, reference_n = (plant, film, controller), [0.0] * (controller.horizon + 1)

    def tip() -> float:
        return plant.tip_m if isinstance(plant, Stepper) else plant.force_n

    def tick(push: float = 0.0, noise: float = 0.0) -> float:
        """Run a tick with the loop cut and `push` as the plant's input; return the output."""
        reading_n = film.read(stiffness_n * tip()) + stiffness_n * noise
        output = controller.output(reference_n, reading_n)
        plant.step(push)
        return output

    def states() -> Array:
        return np.array([read_state(holder, key) for holder, key in state_variables(parts)])

    def set_states(state: Array) -> None:
        for (holder, key), value in zip(state_variables(parts), state.tolist(), strict=True):
            write_state(holder, key, value)

    def column(state: Array, push: float = 0.0, noise: float = 0.0) -> tuple[Array, float]:
        set_states(PROBE * state)
        output = tick(PROBE * push, PROBE * noise)
        return states() / PROBE, output / PROBE

    # The first tick initialises the states that begin as None.
    tick()
    at_rest = np.zeros(len(states()))
    tips = []
    for state in np.eye(len(at_rest)):
        set_states(state)
        tips.append(tip())
    columns = [column(state) for state in np.eye(len(at_rest))]
    noise, through = column(at_rest, noise=1.0)
    pushed, _ = column(at_rest, push=1.0)
    set_states(at_rest)
    plant.place(1.0)
    a = np.array([after for after, _ in columns]).T
    c = np.array([output for _, output in columns])
    return LinearLoop(tick_s, a, pushed, c, noise, through, np.array(tips), states(), counts)


def read_state(holder: Any, key: str | int) -> float:
    """Return a state variable, as `state_variables` yields it."""
    value: float = getattr(holder, key) if isinstance(key, str) else holder[key]
    return value


def write_state(holder: Any, key: str | int, value: float) -> None:
    """Set a state variable, as `state_variables` yields it."""
    if isinstance(key, str):
        setattr(holder, key, value)
    else:
        holder[key] = value


def state_variables(parts: Iterable[Any]) -> Iterator[tuple[Any, str | int]]:
    """Yield each state variable as a part and an attribute's name, or a sequence and an index.

    A part's `STATE` names its state variables: numbers, sequences of numbers, or parts with a
    `STATE` of their own. None is no state.
    """
    for part in parts:
        for name in part.STATE:
            value = getattr(part, name)
            if hasattr(value, "STATE"):
                yield from state_variables([value])
            elif isinstance(value, float):
                yield part, name
            elif value is not None:
                yield from ((value, index) for index in range(len(value)))


# Forces at which a loop is checked, as shares of the force limit: slight touch, a pulse's usual
# mean (0.3 of 2.5 N), and the limit itself.
FORCE_SHARES = (0.008, 0.12, 1.0)
RESPONSE_S = 4.0
# Greatest Ms. Above it, a tenth more gain or a little more delay makes the loop unstable.
FRAGILE = 10.0
# Poles this close to the circle are rounding, or the slow integral of a small ki.
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Margins:
    """Stability of a loop. A margin is infinite if no change of that kind destabilises the loop.

    The classical margins are those at the drive's input, where a wrong step length or a late drive
    acts.

    Attributes
    ----------
    pole_radius
        Largest magnitude of a pole; below 1 is stable.
    gain
        Factor by which the gain may grow.
    phase_deg
        Phase margin in degrees.
    delay_s
        Further delay in s at which the loop becomes unstable.
    peak_sensitivity
        Ms: 1 over the Nyquist curve's distance from −1.
    """

    pole_radius: float
    gain: float
    phase_deg: float
    delay_s: float
    peak_sensitivity: float

    @property
    def stable(self) -> bool:
        """True where every pole lies inside the unit circle."""
        return self.pole_radius < 1 + ROUNDING

    @property
    def unfit(self) -> str | None:
        """Reason not to use this loop with a finger; None if it is stable enough."""
        if not self.stable:
            return f"is not stable (largest pole {self.pole_radius:.4g}, must be below 1)"
        if self.peak_sensitivity > FRAGILE:
            peak = f"peak sensitivity {self.peak_sensitivity:.3g}, above {FRAGILE:g}"
            return f"is hardly stable ({peak})"
        return None


def margins(loop: LinearLoop, frequencies: int = 2_000) -> Margins:
    """Return a loop's margins, from its response at `frequencies` up to half the tick rate."""
    nyquist = math.pi / loop.tick_s
    w = np.geomspace(nyquist * 1e-5, nyquist, frequencies)
    # The cut loop's response, negative feedback counted positive.
    systems = np.exp(1j * w * loop.tick_s)[:, None, None] * np.eye(len(loop.a)) - loop.a
    response = -(loop.c @ np.linalg.solve(systems, loop.b[None, :, None] + 0j)[:, :, 0].T)
    phase = np.unwrap(np.angle(response))
    size = np.log(np.maximum(np.abs(response), 1e-300))
    gain, phase_rad, delay_s = math.inf, math.inf, math.inf
    turn = np.floor((phase / math.pi + 1) / 2)
    for at in np.flatnonzero(np.diff(turn)).tolist():
        opposite_rad = (2 * max(turn[at], turn[at + 1]) - 1) * math.pi
        level = math.exp(-_between(size, at, phase, opposite_rad))
        if level > 1:
            gain = min(gain, level)
    at_nyquist = float(response[-1].real)
    if -1 < at_nyquist < 0:
        gain = min(gain, -1 / at_nyquist)
    for at in np.flatnonzero(np.diff(np.sign(size))).tolist():
        over_rad = (_between(phase, at, size, 0.0) + math.pi) % (2 * math.pi)
        phase_rad = min(phase_rad, over_rad, 2 * math.pi - over_rad)
        delay_s = min(delay_s, over_rad / _between(w, at, size, 0.0))
    return Margins(
        pole_radius=float(np.max(np.abs(loop.poles()))),
        gain=gain,
        phase_deg=math.degrees(phase_rad),
        delay_s=delay_s,
        peak_sensitivity=float(np.max(1 / np.abs(1 + response))),
    )


def _between(values: Array, at: int, at_values: Array, level: float) -> float:
    """Return `values` where `at_values` crosses `level` between entries `at` and the next."""
    span = at_values[at + 1] - at_values[at]
    share = (level - at_values[at]) / span if span else 0.0
    return float(values[at] + share * (values[at + 1] - values[at]))


def felt_noise(loop: LinearLoop, wander: float, noise: float) -> float:
    """Return the RMS of the tip's motion caused by a moving finger and a noisy film.

    Parameters
    ----------
    loop
        The loop; its unit, m or N, is that of the other parameters and of the result.
    wander
        RMS change of the finger's place in 1 s.
    noise
        RMS of a reading's error, white.
    """

    def energy(state: Array) -> float:
        """Return the sum of squares of the tip's motion from a state, without inputs."""
        closed, total = loop.closed, 0.0
        for _ in range(round(RESPONSE_S / loop.tick_s)):
            total += float(loop.tip @ state) ** 2
            state = closed @ state
        return total

    by_noise, by_wander = energy(loop.closed_noise), energy(loop.displaced)
    return math.sqrt(noise**2 * by_noise + wander**2 * loop.tick_s * by_wander)


class UnstableLoopError(SceneError):
    """A force loop is not stable enough; reason: how, in one line."""

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"[display] controller: {reason}: lower its gains, or take those that `telepulse tune`"
            " proposes"
        )
        self.reason = reason


def refuse_unstable(
    controller: ControllerScene,
    actuator: ActuatorScene,
    layer: ElasticLayer,
    film: FilmTable,
    force_limit_n: float,
    tick_s: float,
) -> None:
    """Raise UnstableLoopError for a loop that is not stable enough at a force up to the limit."""
    for share in FORCE_SHARES:
        force_n = share * force_limit_n
        loop = linear_loop(controller, actuator, layer, film, tick_s, force_n)
        reason = margins(loop, frequencies=400).unfit
        if reason is not None:
            raise UnstableLoopError(f"the force loop {reason} at {force_n:.2g} N")
