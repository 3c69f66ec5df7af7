"""Ways to step the force loop of a scene: the error of each at several ticks, and its cost.

Compared is the loop that a scene describes between its limits, in continuous time. Left out are
microsteps, backlash, limits, dead band, noise and the film's converter. An observer then knows the
screw. A loop begins at rest, out of touch, and catches up with the pulse.
"""

import math
import time
from collections.abc import Callable
from functools import partial
from operator import mul
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import expm

from display_node.control.linear_loop import UnstableLoopError
from display_node.plant.contact import ContactLaw, LinearContact
from display_node.plant.film import FilmModel
from display_node.plant.scene import SecondOrderScene, StepperScene
from display_node.plant.stepper import Stepper
from display_node.scene import DisplayScene
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.scene import load_scene

Array = NDArray[np.float64]
SCENES: Final = ("paper", "radial", "real_bench")
# Advances a tick: takes the wanted force from two ticks ago to two ticks ahead, in N, and returns
# the felt force at the tick's end.
Step = Callable[[list[float]], float]
# A step, and the time in s by which its wanted force must be earlier.
Method = tuple[Step, float]
REACH: Final = 2
FINEST_S: Final = 0.25e-3
TICKS_S: Final = (FINEST_S, 0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3)
# The tick at which the cost is shown.
USUAL_S: Final = 1e-3
SECONDS: Final = 1.6
# From first touch until the force is at the pulse.
CATCHING_UP_S: Final = 0.2
# Pulse before the first tick and after the last, for differences and leads.
MARGIN_S: Final = 0.1
REFERENCE_RTOL: Final = 1e-12
# A force beyond this, four times that of the fault, has diverged.
DIVERGED_N: Final = 10.0


class ContinuousLoop(NamedTuple):
    """The loop of a scene between its limits: z' = a z + b u, and the output is out · (z, u).

    Attributes
    ----------
    display
        The scene's display, without what is left out here.
    pulse_n
        Wanted force in N over time in s, with two derivatives.
    law
        Contact law of the output, a position; of 1 N/m where the output is the force itself.
    inverse
        Factors in s and s² of slope and bend of the wanted output in u; 0 without a rotor.
    first
        The state at rest, out of touch, per unit of the first u.
    """

    display: DisplayScene
    pulse_n: BSpline
    law: ContactLaw
    a: Array
    b: Array
    out: list[float]
    inverse: tuple[float, float]
    first: list[float]

    def input(self, wanted_n: list[float], tick_s: float) -> float:
        """Return u from three wanted forces in N, one a tick, by central differences."""
        before, now, after = map(self.law.position, wanted_n)
        slope_s, bend_s2 = self.inverse
        slope, bend = (after - before) / (2 * tick_s), (after - 2 * now + before) / tick_s**2
        return now + slope_s * slope + bend_s2 * bend

    def force(self, state: list[float], u: float) -> float:
        """Return the felt force in N of a state under an input."""
        return self.law.force(sum(map(mul, self.out, [*state, u])))


def continuous_loop(name: str) -> ContinuousLoop:
    """Return the continuous loop of a shipped scene."""
    scene = load_scene(name)
    display, source = scene.display, scene.sensing.source
    assert isinstance(source, SyntheticScene)
    pulse = SyntheticSource(source.model_copy(update={"rate_hz": 1 / FINEST_S, "noise_n": 0.0}))
    pulse_n = pulse.take(round((SECONDS + 2 * MARGIN_S) / FINEST_S))[:, 0]
    gains, actuator = display.controller, display.actuator
    changes = {
        "controller": gains.model_copy(update={"dead_band": 0.0}),
        "safety": display.safety.model_copy(update={"slew_limit_n_per_s": math.inf}),
    }
    if isinstance(actuator, SecondOrderScene):
        m, c, k, rate = actuator.m, actuator.c, actuator.k, 2 * math.pi * gains.derivative_filter_hz
        factors = gains.kp, gains.ki, gains.kd * rate
        kp, ki, kd = (display.film.millivolts_per_newton * factor for factor in factors)
        # Force, its rate, the integral of the error, and the filtered error.
        a = [
            [0, 1, 0, 0],
            [-(k + kp + kd) / m, -c / m, ki / m, -kd / m],
            [-1, 0, 0, 0],
            [-rate, 0, 0, -rate],
        ]
        b = [0, (kp + kd) / m, 1, rate]
        out, inverse, first = [1.0, 0, 0, 0, 0], (0.0, 0.0), [0.0, 0, 0, 1]
        law: ContactLaw = LinearContact(1.0)
    else:
        assert isinstance(actuator, StepperScene)
        law = actuator.contact(display.layer.layer())
        a, b, out, inverse, first = [[-gains.kp]], [0], [1.0, 1.0], (0.0, 0.0), [-1.0]
        if (hz := actuator.rotor_resonance_hz) is not None:
            w, damping = 2 * math.pi * hz, actuator.rotor_damping
            # The screw's error, the rotor and its speed.
            a = [[-gains.kp, 0, 0], [0, 0, 1], [w * w, -w * w, -2 * damping * w]]
            b = [0, 0, w * w]
            out, inverse, first = [0.0, 1, 0, 0], (2 * damping / w, 1 / w**2), [-1.0, 0, 0]
        changes["actuator"] = actuator.model_copy(
            update={
                # Finer than any force that is compared.
                "microsteps": 1 << 40,
                "backlash_m": 0.0,
                "max_speed_m_per_s": math.inf,
                "max_acceleration_m_per_s2": math.inf,
            }
        )
    return ContinuousLoop(
        display=display.model_copy(update=changes),
        pulse_n=make_interp_spline(FINEST_S * np.arange(len(pulse_n)) - MARGIN_S, pulse_n, 5),
        law=law,
        a=np.array(a, float),
        b=np.array(b, float),
        out=out,
        inverse=inverse,
        first=first,
    )


def reference_n(loop: ContinuousLoop, longest_s: float) -> Array:
    """Return the felt force in N at each of the finest ticks' ends, without differences of ticks.

    longest_s: longest step of the solver.
    """
    at_s = np.unique(loop.pulse_n.t)
    wanted = make_interp_spline(at_s, [*map(loop.law.position, loop.pulse_n(at_s))], 5)
    fed = wanted(at_s) + np.dot(loop.inverse, [wanted(at_s, 1), wanted(at_s, 2)])
    path = make_interp_spline(at_s, fed, 5)
    ends_s = FINEST_S * np.arange(1, 1 + round(SECONDS / FINEST_S))
    solved = solve_ivp(
        lambda t_s, z: loop.a @ z + loop.b * path(t_s),
        (0.0, SECONDS),
        [share * float(path(0.0)) for share in loop.first],
        method="DOP853",
        rtol=REFERENCE_RTOL,
        atol=REFERENCE_RTOL * 1e-3 * float(np.abs(fed).max()),
        t_eval=ends_s,
        max_step=longest_s,
    )
    states = zip(solved.y.T.tolist(), path(ends_s).tolist(), strict=True)
    return np.array([loop.force(state, u) for state, u in states])


def explicit(loop: ContinuousLoop, tick_s: float) -> Method:
    """Return the paper's way: the PID of the last reading, with differences backwards, held."""
    gains, actuator, law = loop.display.controller, loop.display.actuator, loop.law
    pid = gains.pid(tick_s, math.inf)
    if not isinstance(actuator, StepperScene):
        plant, unit = actuator.build(tick_s), loop.display.film.millivolts_per_newton
        return lambda wanted: plant.step(pid.step(unit * (wanted[REACH] - plant.force_n))), 0.0
    stepper = Stepper(actuator, law, math.inf, tick_s, linear=True)
    fed: list[float] = []

    def step(wanted_n: list[float]) -> float:
        u = loop.input(wanted_n[: REACH + 1], tick_s)
        before = fed.pop() if fed else u
        fed.append(u)
        return stepper.step(pid.step(u - stepper.screw_m, feed_forward=(u - before) / tick_s))

    return step, 0.0


def solved(loop: ContinuousLoop, tick_s: float) -> Method:
    """Return the display's own way: the PID is solved with the actuator's next step.

    Raises UnstableLoopError.
    """
    force_loop = loop.display.model_copy(update={"tick_ns": round(1e9 * tick_s)}).force_loop()
    quiet = loop.display.film.model_copy(update={"noise_n": 0.0, "adc_bits": None})
    film, last = FilmModel(quiet, tick_s), REACH + 1 + force_loop.horizon

    def step(wanted_n: list[float]) -> float:
        force_loop.tick(wanted_n[REACH:last], film.read(force_loop.felt_n))
        return force_loop.felt_n

    return step, force_loop.actuation_delay_ns * 1e-9


def exact(loop: ContinuousLoop, tick_s: float) -> Method:
    """Return the exact way: the exponential of the whole loop's matrix, u linear over a tick."""
    count = len(loop.a)
    system = np.zeros((count + 2, count + 2))
    system[:count, :count], system[:count, count] = loop.a * tick_s, loop.b * tick_s
    system[count, count + 1] = 1.0
    rows: list[list[float]] = expm(system)[:count].tolist()

    def advance(state: list[float], u: float, change: float) -> list[float]:
        return [sum(map(mul, row, [*state, u, change])) for row in rows]

    return _by_states(loop, tick_s, advance), 0.0


def library(loop: ContinuousLoop, tick_s: float, rtol: float) -> Method:
    """Return scipy's `solve_ivp` (RK45), called each tick, u linear over it."""

    def advance(state: list[float], u: float, change: float) -> list[float]:
        solution = solve_ivp(
            lambda t_s, z: loop.a @ z + loop.b * (u + change * t_s / tick_s),
            (0.0, tick_s),
            state,
            method="RK45",
            rtol=rtol,
            atol=rtol * 1e-3 * (abs(u) + 1e-9),
        )
        return list(solution.y[:, -1].tolist())

    return _by_states(loop, tick_s, advance), 0.0


def _by_states(
    loop: ContinuousLoop,
    tick_s: float,
    advance: Callable[[list[float], float, float], list[float]],
) -> Step:
    state: list[float] = []

    def step(wanted_n: list[float]) -> float:
        u = loop.input(wanted_n[REACH - 1 : REACH + 2], tick_s)
        next_u = loop.input(wanted_n[REACH : REACH + 3], tick_s)
        state[:] = advance(state or [share * u for share in loop.first], u, next_u - u)
        return loop.force(state, next_u)

    return step


SHIPPED: Final = "solved with the actuator's step: the display's"
WAYS: Final[dict[str, Callable[[ContinuousLoop, float], Method]]] = {
    "explicit, as in the paper": explicit,
    SHIPPED: solved,
    "exact: the loop's matrix exponential": exact,
    "`solve_ivp`, 1e-3": partial(library, rtol=1e-3),
    "`solve_ivp`, 1e-9": partial(library, rtol=1e-9),
}


class Errors(NamedTuple):
    """RMS errors of the force over the pulse's peak to peak; infinite where the loop diverged."""

    catching_up: float
    following: float


class Score(NamedTuple):
    """A way to step a scene's loop: its errors by the tick in s, and the processor time of a tick.

    Errors are None where the display refuses the loop.
    """

    scene: str
    way: str
    errors: dict[float, Errors | None]
    p50_us: float
    p99_us: float


def run(method: Method, loop: ContinuousLoop, tick_s: float) -> tuple[Array, Array]:
    """Return the felt force in N and the processor time in µs of each tick, less the clock's."""
    (step, lead_s), felt_n, took_ns, now_ns = method, [], [], time.process_time_ns
    ticks = np.arange(round(SECONDS / tick_s))[:, None] + np.arange(-REACH, REACH + 1)
    windows = loop.pulse_n(tick_s * ticks + lead_s).tolist()
    clock_ns = np.median([-now_ns() + now_ns() for _ in windows])
    for window in windows:
        began_ns = now_ns()
        felt_n.append(step(window))
        took_ns.append(now_ns() - began_ns)
        if not abs(felt_n[-1]) < DIVERGED_N:
            break
    return np.array(felt_n), 1e-3 * (np.array(took_ns) - clock_ns)


def errors_of(felt_n: Array, true_n: Array, height_n: float, tick_s: float) -> Errors:
    """Return the errors at the ticks' ends."""
    every, caught_up = round(tick_s / FINEST_S), round(CATCHING_UP_S / tick_s)
    wanted_n = true_n[every - 1 :: every]
    if len(felt_n) < len(wanted_n) or not abs(felt_n[-1]) < DIVERGED_N:
        return Errors(math.inf, math.inf)
    squares = ((felt_n - wanted_n) / height_n) ** 2
    return Errors(math.sqrt(squares[:caught_up].mean()), math.sqrt(squares[caught_up:].mean()))


def score(name: str) -> tuple[list[Score], float]:
    """Return the scores of a scene's loop, and the change of the reference on halving its step.

    The change is over the pulse's peak to peak, as the errors are.
    """
    loop = continuous_loop(name)
    true_n = reference_n(loop, FINEST_S)
    height_n = float(np.ptp(loop.pulse_n(np.arange(0.0, SECONDS, FINEST_S))))
    scores = []
    for label, make in WAYS.items():
        errors, costs_us = dict[float, Errors | None](), [math.nan, math.nan]
        for tick_s in TICKS_S:
            try:
                felt_n, took_us = run(make(loop, tick_s), loop, tick_s)
            except UnstableLoopError:
                errors[tick_s] = None
                continue
            errors[tick_s] = errors_of(felt_n, true_n, height_n, tick_s)
            if tick_s == USUAL_S:
                costs_us = np.percentile(took_us, (50, 99)).tolist()
        scores.append(Score(name, label, errors, *costs_us))
    return scores, float(np.abs(reference_n(loop, 2 * FINEST_S) - true_n).max()) / height_n
