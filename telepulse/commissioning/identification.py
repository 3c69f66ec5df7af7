"""Identification of eq 22 from a record: m, c, k and the latency by nonlinear least squares.

The exact response to the recorded command is fitted by scipy's trust-region least squares, with
the film's zero as a fifth unknown. Starting points come from a grid of resonance, damping and
latency; at each of its points, gain and zero follow by linear least squares. The intervals are
those of the Jacobian, with the covariance of autocorrelated residuals (Newey and West,
Econometrica 55, 1987), since a film's filter makes its noise correlated.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from protocol.errors import BenchError

Array = NDArray[np.float64]

NAMES = ("m", "c", "k", "latency")
# Half-width of the 95 % interval of a normal distribution, in standard deviations.
DEVIATIONS_95 = 1.96
LEAST_SAMPLES = 50
# A parameter is undetermined when its half-width is above this share of its value.
MAX_HALF_WIDTH = 0.5
START_DAMPINGS = (0.1, 0.5, 2.0)
START_RESONANCES = 16
START_READINGS = 2_000
STARTS = 3
MAX_EVALUATIONS = 50
TINY = 1e-300
# Lags of the residuals' autocorrelation: this times the cube root of the number of readings.
LAGS_PER_CUBE_ROOT = 3
DELAYS_PER_TICK = 20
# An inertia below this share of the starting point's makes no difference between two ticks.
LEAST_INERTIA = 1e-3
STEP_POINTS = 4_000
SETTLED = 0.02
LEAST_DAMPING = 0.02


@dataclass(frozen=True, slots=True)
class SecondOrderModel:
    """Eq 22, g(s) = 1/(m s² + c s + k), with a latency.

    Where command and output are both forces, k has no unit, c is in s and m in s².
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
    """Commanded values, one per tick from time 0.

    held: each value holds until the next one (zero-order hold, as a voltage does). Otherwise the
    input runs straight to the next value, as the travel of a screw does at a held speed.
    """

    values: Array
    tick_s: float
    held: bool

    @property
    def time_s(self) -> Array:
        """Times of the values."""
        return np.asarray(self.tick_s * np.arange(len(self.values)))


def respond(model: SecondOrderModel, command: ActuatorInput, at_s: Array) -> Array:
    """Return the output at times `at_s`, from rest under the command's first value.

    The output is exact at the ticks (matrix exponential). Between them it is a cubic through
    values and rates, with an error below 1e-3 of a step for a resonance below a sixth of the tick
    rate.
    """
    output, rate = _at_ticks(model, command)
    ticks = np.clip((at_s - model.latency_s) / command.tick_s, 0.0, len(output) - 1.0)
    before = np.minimum(ticks.astype(np.int64), len(output) - 2)
    after, part = before + 1, ticks - before
    rest = 1 - part
    between = rest**2 * ((1 + 2 * part) * output[before] + part * rate[before])
    between += part**2 * ((1 + 2 * rest) * output[after] - rest * rate[after])
    return np.asarray(between)


def _at_ticks(model: SecondOrderModel, command: ActuatorInput) -> tuple[Array, Array]:
    """Return the output at the ticks, and its rate per tick."""
    from scipy.linalg import expm
    from scipy.signal import lfilter

    # The state is (output, its rate, command, the command's slope).
    system = np.zeros((4, 4))
    system[0, 1] = system[2, 3] = 1.0
    system[1, :3] = np.array([-model.k, -model.c, 1.0]) / model.m
    moved = expm(system * command.tick_s)[:2]
    advance, by_start, by_slope = moved[:, :2], moved[:, 2], moved[:, 3]
    u = command.values - command.values[0]
    slope = np.zeros_like(u) if command.held else np.append(np.diff(u), 0.0) / command.tick_s
    trace, determinant = np.trace(advance), np.linalg.det(advance)
    characteristic = np.array([1.0, -trace, determinant])
    # (z − A)⁻¹ of a 2 × 2 matrix is (adjugate + z) over its characteristic polynomial.
    adjugate = advance - trace * np.eye(2)
    states = np.zeros((2, len(u)))
    for into, signal in ((by_start, u), (by_slope, slope)):
        second = adjugate @ into
        for row in range(2):
            states[row] += lfilter([0.0, into[row], second[row]], characteristic, signal)
    return states[0] + command.values[0] / model.k, states[1] * command.tick_s


def step_response(model: SecondOrderModel) -> tuple[float, float, float]:
    """Return rise in s, overshoot and settling in s of eq 22's response to a step.

    The rise is from 10 to 90 %; the overshoot beyond the end value, as a share of it; the settling
    from the command until the response stays within 2 %, latency included.
    """
    damping = max(model.damping, LEAST_DAMPING)
    horizon_s = 10 * max(1 / damping, 2 * damping) / (2 * np.pi * model.resonance_hz)
    t_s = np.linspace(0.0, horizon_s, STEP_POINTS)
    values = np.ones(STEP_POINTS)
    values[0] = 0.0
    step = ActuatorInput(values, float(t_s[1]), held=True)
    share = model.k * respond(replace(model, latency_s=0.0), step, t_s)
    reached = [t_s[np.argmax(share >= level)] for level in (0.1, 0.9)]
    outside = np.flatnonzero(np.abs(share - 1) > SETTLED)
    overshoot = max(0.0, float(share.max()) - 1)
    return float(reached[1] - reached[0]), overshoot, model.latency_s + float(t_s[outside[-1]])


@dataclass(frozen=True, slots=True)
class IdentifiedModel:
    """A fitted model.

    half_widths: 95 % intervals of `values`, to either side. zero_n: reading of the film without
    force. nrmse: RMS of the residuals over the standard deviation of the force. undetermined:
    parameters that the record does not determine. delay_s: delay of slow changes, latency and c/k
    together.
    """

    model: SecondOrderModel
    half_widths: tuple[float, float, float, float]
    zero_n: float
    nrmse: float
    undetermined: tuple[str, ...]
    delay_s: float

    @property
    def values(self) -> tuple[float, float, float, float]:
        """m, c, k and latency in s."""
        return self.model.m, self.model.c, self.model.k, self.model.latency_s


def identify(
    command: ActuatorInput, at_s: Array, force_n: Array, max_latency_s: float
) -> IdentifiedModel:
    """Return the model whose response to `command` fits the readings best.

    Parameters
    ----------
    command : ActuatorInput
        Commands; if the readings passed a filter, commands that passed the same filter.
    at_s, force_n : NDArray, shape (n,)
        Times and values of the film's readings.
    max_latency_s : float
        Largest latency of the starting points.

    Raises
    ------
    BenchError
        For too few readings, or a record in which nothing moves.
    """
    if len(force_n) < LEAST_SAMPLES:
        raise BenchError(f"{len(force_n)} readings of the film; at least {LEAST_SAMPLES} needed")
    if not np.ptp(command.values) or not np.ptp(force_n):
        still = "the command" if not np.ptp(command.values) else "the film"
        raise BenchError(f"{still} does not change; nothing can be identified")
    starts = _starts(command, at_s, force_n, max_latency_s)
    fits = [_refine(start, command, at_s, force_n) for start in starts]
    scale, found, jacobian, residual = min(fits, key=lambda fit: float(fit[3] @ fit[3]))
    values: Array = found * scale
    half_widths = DEVIATIONS_95 * (_deviations(jacobian, residual) * scale)[:4]
    # With a resonance above half the tick rate, the inertia has no effect at the ticks.
    heavy = values[2] / values[0] < (math.pi / command.tick_s) ** 2
    limits = MAX_HALF_WIDTH * np.array([values[0] * heavy, *values[1:3], 2 * command.tick_s])
    undetermined = tuple(
        name for name, w, most in zip(NAMES, half_widths, limits, strict=True) if w > most
    )
    model = SecondOrderModel(*values[:4].tolist())
    delay_s = model.latency_s + model.c / model.k
    if {"m", "c"} & set(undetermined):
        delay_s = _pure_delay_s(command, at_s, force_n, max_latency_s)
    return IdentifiedModel(
        model=model,
        half_widths=tuple(half_widths.tolist()),
        zero_n=float(values[4]),
        nrmse=float(np.std(residual) / np.std(force_n)),
        undetermined=undetermined,
        delay_s=delay_s,
    )


def _starts(
    command: ActuatorInput, at_s: Array, force_n: Array, max_latency_s: float
) -> list[tuple[SecondOrderModel, float]]:
    """Return the best models of the grid on a part of the readings, each with the film's zero."""
    thin = slice(None, None, -(-len(force_n) // START_READINGS))
    at_s, force_n = at_s[thin], force_n[thin]
    mean_n = float(force_n.mean())
    tick_s = command.tick_s
    slowest_hz, fastest_hz = 0.2 / (len(command.values) * tick_s), 1 / tick_s
    latencies_s = np.arange(0.0, max_latency_s + tick_s, tick_s)
    found: list[tuple[float, SecondOrderModel, float]] = []
    for w in 2 * np.pi * np.geomspace(slowest_hz, fastest_hz, START_RESONANCES):
        for damping in START_DAMPINGS:
            unit = SecondOrderModel(1 / w**2, 2 * damping / w, 1.0)
            answers = respond(unit, command, at_s - latencies_s[:, None])
            for latency_s, answer in zip(latencies_s.tolist(), answers, strict=True):
                spread = answer - answer.mean()
                gain = float(spread @ force_n) / max(float(spread @ spread), TINY)
                if gain <= 0:
                    continue
                off = force_n - mean_n - gain * spread
                model = SecondOrderModel(unit.m / gain, unit.c / gain, 1 / gain, latency_s)
                found.append((float(off @ off), model, mean_n - gain * float(answer.mean())))
    if not found:
        raise BenchError(
            "the film's reading falls while the command rises: change `inverted` of the drive"
        )
    found.sort(key=lambda each: each[0])
    return [(model, zero_n) for _, model, zero_n in found[:STARTS]]


def _refine(
    start: tuple[SecondOrderModel, float], command: ActuatorInput, at_s: Array, force_n: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the scale of the five unknowns, their values in it, Jacobian and residuals."""
    from scipy.optimize import least_squares

    model, zero_n = start
    scale = np.array([model.m, model.c, model.k, command.tick_s, np.std(force_n)])

    def residuals(x: Array) -> Array:
        m, c, k, latency_s, zero = (x * scale).tolist()
        response_n = respond(SecondOrderModel(m, c, k, latency_s), command, at_s)
        return np.asarray(response_n + zero - force_n)

    fit = least_squares(
        residuals,
        np.array([1.0, 1.0, 1.0, model.latency_s / command.tick_s, zero_n / scale[4]]),
        bounds=([LEAST_INERTIA, 0.0, 1e-9, 0.0, -np.inf], np.inf),
        x_scale="jac",
        max_nfev=MAX_EVALUATIONS,
    )
    return scale, fit.x, np.asarray(fit.jac), fit.fun


def _pure_delay_s(
    command: ActuatorInput, at_s: Array, force_n: Array, max_latency_s: float
) -> float:
    """Return the delay with the largest correlation of command and force, to a 20th of a tick.

    Where inertia and damping are undetermined, they and the latency can replace one another.
    """
    # A sensor's stamps may be early: the time at which its first byte was sent is unknown.
    delays_s = np.arange(-command.tick_s, max_latency_s, command.tick_s / DELAYS_PER_TICK)
    delayed = [np.interp(at_s - each, command.time_s, command.values) for each in delays_s.tolist()]
    return float(delays_s[np.argmax([np.corrcoef(each, force_n)[0, 1] for each in delayed])])


def _deviations(jacobian: Array, residual: Array) -> Array:
    """Return the standard deviations of the unknowns, from autocorrelated residuals."""
    n, unknowns = jacobian.shape
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    score = jacobian * residual[:, None]
    lags = round(LAGS_PER_CUBE_ROOT * n ** (1 / 3))
    middle = score.T @ score
    for lag in range(1, lags + 1):
        pair = score[lag:].T @ score[:-lag]
        middle += (1 - lag / (lags + 1)) * (pair + pair.T)
    correlated = inverse @ middle @ inverse * n
    independent = inverse * float(residual @ residual)
    # From few residuals that are correlated, the first estimate may come out too small.
    larger = np.maximum(np.diag(correlated), np.diag(independent)) / (n - unknowns)
    return np.asarray(np.sqrt(larger))
