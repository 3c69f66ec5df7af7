"""Eq 22 from a record: m, c, k and the latency by nonlinear least squares.

The exact response to the recorded input is fitted (scipy's trust-region least squares) with a
zero of the film as a fifth unknown. Starts are searched on a grid of resonance, damping and
latency, where gain and zero are linear. Intervals are the Jacobian's, with the covariance of
residuals that follow one another (Newey and West, Econometrica 55, 1987): what a film's filter
makes of noise is not white.

Eq 22 under a known input and a latency: its exact response at any time.

How an identified actuator answers a step.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.errors import BenchError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SecondOrderModel:
    """Eq 22, g(s) = 1/(m s² + c s + k), that answers `latency_s` late.

    Where input and output are both forces, k is a plain number, c is in s and m in s².
    """

    m: float
    c: float
    k: float
    latency_s: float = 0.0

    @property
    def resonance_hz(self) -> float:
        """Undamped natural frequency."""
        return float(np.sqrt(self.k / self.m) / (2 * np.pi))

    @property
    def damping(self) -> float:
        """Damping ratio ζ."""
        return float(self.c / (2 * np.sqrt(self.k * self.m)))


@dataclass(frozen=True, slots=True)
class ActuatorInput:
    """What the actuator was told, at 0, tick_s, 2 tick_s …

    held: it stays until the next value (zero-order hold, as a voltage does); otherwise it runs
    straight to it, as the place of a screw does whose speed is held.
    """

    values: Array
    tick_s: float
    held: bool


def respond(model: SecondOrderModel, told: ActuatorInput, at_s: Array) -> Array:
    """The output at times at_s, which begins at rest under the input's first value.

    Exact at the ticks by the matrix exponential; between them a cubic through values and rates,
    whose error is below 1e-3 of a step for a resonance below a sixth of the tick rate.
    """
    output, rate = _at_ticks(model, told)
    ticks = np.clip((at_s - model.latency_s) / told.tick_s, 0.0, len(output) - 1.0)
    before = np.minimum(ticks.astype(np.int64), len(output) - 2)
    after, part = before + 1, ticks - before
    rest = 1 - part
    between = rest**2 * ((1 + 2 * part) * output[before] + part * rate[before])
    between += part**2 * ((1 + 2 * rest) * output[after] - rest * rate[after])
    return np.asarray(between)


def _at_ticks(model: SecondOrderModel, told: ActuatorInput) -> tuple[Array, Array]:
    """The output at the ticks, and its change in a tick's time."""
    from scipy.signal import lfilter

    advance, by_start, by_slope = _transition(model, told)
    u = told.values - told.values[0]
    slope = np.zeros_like(u) if told.held else np.append(np.diff(u), 0.0) / told.tick_s
    trace, determinant = np.trace(advance), np.linalg.det(advance)
    characteristic = np.array([1.0, -trace, determinant])
    # (z − A)⁻¹ of a 2 × 2 matrix is (adjugate + z) over its characteristic polynomial.
    adjugate = advance - trace * np.eye(2)
    states = np.zeros((2, len(u)))
    for into, signal in ((by_start, u), (by_slope, slope)):
        second = adjugate @ into
        for row in range(2):
            states[row] += lfilter([0.0, into[row], second[row]], characteristic, signal)
    return states[0] + told.values[0] / model.k, states[1] * told.tick_s


def _transition(model: SecondOrderModel, told: ActuatorInput) -> tuple[Array, Array, Array]:
    """What a tick makes of (output, its rate), of the input at its start and of its slope."""
    from scipy.linalg import expm

    system = np.zeros((4, 4))
    system[0, 1] = system[2, 3] = 1.0
    system[1, :3] = np.array([-model.k, -model.c, 1.0]) / model.m
    moved = expm(system * told.tick_s)[:2]
    return moved[:, :2], moved[:, 2], moved[:, 3]


POINTS = 4_000
SETTLED = 0.02
LEAST_DAMPING = 0.02


@dataclass(frozen=True, slots=True)
class StepResponse:
    """rise_s: from 10 to 90 %; overshoot: beyond the end value, as a share of it; settling_s:
    from the command until it stays within 2 %, the latency included."""

    rise_s: float
    overshoot: float
    settling_s: float


def step_response(model: SecondOrderModel) -> StepResponse:
    """The response of eq 22 to a step."""
    damping = max(model.damping, LEAST_DAMPING)
    horizon_s = 10 * max(1 / damping, 2 * damping) / (2 * np.pi * model.resonance_hz)
    t_s = np.linspace(0.0, horizon_s, POINTS)
    values = np.ones(POINTS)
    values[0] = 0.0
    undelayed = SecondOrderModel(model.m, model.c, model.k)
    share = model.k * respond(undelayed, ActuatorInput(values, float(t_s[1]), held=True), t_s)
    reached = [t_s[np.argmax(share >= level)] for level in (0.1, 0.9)]
    outside = np.flatnonzero(np.abs(share - 1) > SETTLED)
    return StepResponse(
        rise_s=float(reached[1] - reached[0]),
        overshoot=max(0.0, float(share.max()) - 1),
        settling_s=model.latency_s + float(t_s[outside[-1]]),
    )


NAMES = ("m", "c", "k", "latency")
# 95 % of a normal distribution lie within so many standard deviations.
WITHIN = 1.96
LEAST_SAMPLES = 50
# A parameter whose interval reaches further than this share of it to either side is not told.
TOLD = 0.5
START_DAMPINGS = (0.1, 0.5, 2.0)
START_RESONANCES = 16
START_READINGS = 2_000
STARTS = 3
MOST_TRIES = 50
TINY = 1e-300
LAGS = 3
DELAYS_A_TICK = 20
# An inertia below this share of a start's makes no difference between two ticks.
LEAST_INERTIA = 1e-3


@dataclass(frozen=True, slots=True)
class IdentifiedModel:
    """The fitted model; `within`: 95 % intervals, to either side, of m, c, k and latency in s.

    nrmse: RMS of what is not explained over that of the whole change; zero_n: the film's
    reading without force; untold: which of the parameters the record does not determine.
    delay_s: by how much slow changes are late, latency and c/k together.
    """

    model: SecondOrderModel
    within: tuple[float, float, float, float]
    zero_n: float
    nrmse: float
    untold: tuple[str, ...]
    delay_s: float

    @property
    def values(self) -> tuple[float, float, float, float]:
        """m, c, k and latency in s, in the order of `within`."""
        return self.model.m, self.model.c, self.model.k, self.model.latency_s


def identify(
    told: ActuatorInput, at_s: Array, force_n: Array, longest_latency_s: float
) -> IdentifiedModel:
    """The model that answers `told` with force_n at times at_s, shape (n,) each.

    A filter that the reading went through is made good by sending `told` through the same one.
    Raises BenchError for a record in which nothing moves.
    """
    if len(force_n) < LEAST_SAMPLES:
        raise BenchError(f"{len(force_n)} readings of the film; at least {LEAST_SAMPLES} needed")
    if not np.ptp(told.values) or not np.ptp(force_n):
        still = "the command" if not np.ptp(told.values) else "the film"
        raise BenchError(f"{still} does not change; nothing can be identified")
    starts = _starts(told, at_s, force_n, longest_latency_s)
    fits = [_refine(start, told, at_s, force_n) for start in starts]
    scale, found, jacobian, residual = min(fits, key=lambda fit: float(fit[3] @ fit[3]))
    spread = _spread(jacobian, residual) * scale
    values: Array = found * scale
    within = WITHIN * spread[:4]
    # What rings faster than half the tick rate is between two ticks, and any inertia fits it.
    heavy = values[2] / values[0] < (math.pi / told.tick_s) ** 2
    limits = TOLD * np.array([values[0] * heavy, *values[1:3], 2 * told.tick_s])
    untold = tuple(name for name, w, most in zip(NAMES, within, limits, strict=True) if w > most)
    model = SecondOrderModel(*values[:4].tolist())
    delay_s = model.latency_s + model.c / model.k
    if {"m", "c"} & set(untold):
        delay_s = _pure_delay_s(told, at_s, force_n, longest_latency_s)
    return IdentifiedModel(
        model=model,
        within=tuple(within.tolist()),
        zero_n=float(values[4]),
        nrmse=float(np.std(residual) / np.std(force_n)),
        untold=untold,
        delay_s=delay_s,
    )


def _starts(
    told: ActuatorInput, at_s: Array, force_n: Array, longest_latency_s: float
) -> list[tuple[SecondOrderModel, float]]:
    """The best models of the grid on a part of the readings, each with the film's zero."""
    thin = slice(None, None, -(-len(force_n) // START_READINGS))
    at_s, force_n = at_s[thin], force_n[thin]
    mean_n = float(force_n.mean())
    slowest_hz, fastest_hz = 0.2 / (len(told.values) * told.tick_s), 1 / told.tick_s
    latencies_s = np.arange(0.0, longest_latency_s + told.tick_s, told.tick_s)
    found: list[tuple[float, SecondOrderModel, float]] = []
    for w in 2 * np.pi * np.geomspace(slowest_hz, fastest_hz, START_RESONANCES):
        for damping in START_DAMPINGS:
            unit = SecondOrderModel(1 / w**2, 2 * damping / w, 1.0)
            answers = respond(unit, told, at_s - latencies_s[:, None])
            for latency_s, answer in zip(latencies_s.tolist(), answers, strict=True):
                spread = answer - answer.mean()
                gain = float(spread @ force_n) / max(float(spread @ spread), TINY)
                if gain <= 0:
                    continue
                off = force_n - mean_n - gain * spread
                model = SecondOrderModel(unit.m / gain, unit.c / gain, 1 / gain, latency_s)
                found.append((float(off @ off), model, mean_n - gain * float(answer.mean())))
    if not found:
        raise BenchError("the film falls where the command rises: turn the drive's direction round")
    found.sort(key=lambda each: each[0])
    return [(model, zero_n) for _, model, zero_n in found[:STARTS]]


def _refine(
    start: tuple[SecondOrderModel, float], told: ActuatorInput, at_s: Array, force_n: Array
) -> tuple[Array, Array, Array, Array]:
    """Scale of the five unknowns, their values in it, Jacobian and residuals."""
    from scipy.optimize import least_squares

    model, zero_n = start
    scale = np.array([model.m, model.c, model.k, told.tick_s, np.std(force_n)])

    def off(x: Array) -> Array:
        m, c, k, latency_s, zero = (x * scale).tolist()
        return np.asarray(
            respond(SecondOrderModel(m, c, k, latency_s), told, at_s) + zero - force_n
        )

    first = np.array([1.0, 1.0, 1.0, model.latency_s / told.tick_s, zero_n / scale[4]])
    fit = least_squares(
        off,
        first,
        bounds=([LEAST_INERTIA, 0.0, 1e-9, 0.0, -np.inf], np.inf),
        x_scale="jac",
        max_nfev=MOST_TRIES,
    )
    return scale, fit.x, np.asarray(fit.jac), fit.fun


def _pure_delay_s(
    told: ActuatorInput, at_s: Array, force_n: Array, longest_latency_s: float
) -> float:
    """The delay at which the input goes best with the force, to a twentieth of a tick.

    Where inertia and damping are not told, they and the latency stand in for one another.
    """
    t_s = told.tick_s * np.arange(len(told.values))
    # A sensor's stamps may be early: nothing tells when its first byte was sent.
    delays_s = np.arange(-told.tick_s, longest_latency_s, told.tick_s / DELAYS_A_TICK)
    late = [np.interp(at_s - delay_s, t_s, told.values) for delay_s in delays_s.tolist()]
    return float(delays_s[np.argmax([np.corrcoef(each, force_n)[0, 1] for each in late])])


def _spread(jacobian: Array, residual: Array) -> Array:
    """Standard deviations of the unknowns, from residuals of which near ones go together."""
    n, unknowns = jacobian.shape
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    score = jacobian * residual[:, None]
    lags = round(LAGS * n ** (1 / 3))
    middle = score.T @ score
    for lag in range(1, lags + 1):
        pair = score[lag:].T @ score[:-lag]
        middle += (1 - lag / (lags + 1)) * (pair + pair.T)
    together = inverse @ middle @ inverse * n
    alone = inverse * float(residual @ residual)
    # Estimated from few residuals that go together, the first may come out too small.
    larger = np.maximum(np.diag(together), np.diag(alone)) / (n - unknowns)
    return np.asarray(np.sqrt(larger))
