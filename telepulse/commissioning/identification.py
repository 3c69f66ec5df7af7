"""Eq 22 from a record: m, c, k and the latency by nonlinear least squares.

The exact response to the recorded input is fitted (scipy's trust-region least squares) with a
zero of the film as a fifth unknown. Starts are searched on a grid of resonance, damping and
latency, where gain and zero are linear. Intervals are the Jacobian's, with the covariance of
residuals that follow one another (Newey and West, Econometrica 55, 1987): what a film's filter
makes of noise is not white.
"""

import math
from dataclasses import dataclass

import numpy as np

from protocol.errors import BenchError
from telepulse.commissioning.response import Array, Input, Model, respond

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
class Identified:
    """The fitted model; `within`: 95 % intervals, to either side, of m, c, k and latency in s.

    nrmse: RMS of what is not explained over that of the whole change; zero_n: the film's
    reading without force; untold: which of the parameters the record does not determine.
    delay_s: by how much slow changes are late, latency and c/k together.
    """

    model: Model
    within: tuple[float, float, float, float]
    zero_n: float
    nrmse: float
    untold: tuple[str, ...]
    delay_s: float

    @property
    def values(self) -> tuple[float, float, float, float]:
        """m, c, k and latency in s, in the order of `within`."""
        return self.model.m, self.model.c, self.model.k, self.model.latency_s


def identify(told: Input, at_s: Array, force_n: Array, longest_latency_s: float) -> Identified:
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
    model = Model(*values[:4].tolist())
    delay_s = model.latency_s + model.c / model.k
    if {"m", "c"} & set(untold):
        delay_s = _pure_delay_s(told, at_s, force_n, longest_latency_s)
    return Identified(
        model=model,
        within=tuple(within.tolist()),
        zero_n=float(values[4]),
        nrmse=float(np.std(residual) / np.std(force_n)),
        untold=untold,
        delay_s=delay_s,
    )


def _starts(
    told: Input, at_s: Array, force_n: Array, longest_latency_s: float
) -> list[tuple[Model, float]]:
    """The best models of the grid on a part of the readings, each with the film's zero."""
    thin = slice(None, None, -(-len(force_n) // START_READINGS))
    at_s, force_n = at_s[thin], force_n[thin]
    mean_n = float(force_n.mean())
    slowest_hz, fastest_hz = 0.2 / (len(told.values) * told.tick_s), 1 / told.tick_s
    latencies_s = np.arange(0.0, longest_latency_s + told.tick_s, told.tick_s)
    found: list[tuple[float, Model, float]] = []
    for w in 2 * np.pi * np.geomspace(slowest_hz, fastest_hz, START_RESONANCES):
        for damping in START_DAMPINGS:
            unit = Model(1 / w**2, 2 * damping / w, 1.0)
            answers = respond(unit, told, at_s - latencies_s[:, None])
            for latency_s, answer in zip(latencies_s.tolist(), answers, strict=True):
                spread = answer - answer.mean()
                gain = float(spread @ force_n) / max(float(spread @ spread), TINY)
                if gain <= 0:
                    continue
                off = force_n - mean_n - gain * spread
                model = Model(unit.m / gain, unit.c / gain, 1 / gain, latency_s)
                found.append((float(off @ off), model, mean_n - gain * float(answer.mean())))
    if not found:
        raise BenchError("the film falls where the command rises: turn the drive's direction round")
    found.sort(key=lambda each: each[0])
    return [(model, zero_n) for _, model, zero_n in found[:STARTS]]


def _refine(
    start: tuple[Model, float], told: Input, at_s: Array, force_n: Array
) -> tuple[Array, Array, Array, Array]:
    """Scale of the five unknowns, their values in it, Jacobian and residuals."""
    from scipy.optimize import least_squares

    model, zero_n = start
    scale = np.array([model.m, model.c, model.k, told.tick_s, np.std(force_n)])

    def off(x: Array) -> Array:
        m, c, k, latency_s, zero = (x * scale).tolist()
        return np.asarray(respond(Model(m, c, k, latency_s), told, at_s) + zero - force_n)

    first = np.array([1.0, 1.0, 1.0, model.latency_s / told.tick_s, zero_n / scale[4]])
    fit = least_squares(
        off,
        first,
        bounds=([LEAST_INERTIA, 0.0, 1e-9, 0.0, -np.inf], np.inf),
        x_scale="jac",
        max_nfev=MOST_TRIES,
    )
    return scale, fit.x, np.asarray(fit.jac), fit.fun


def _pure_delay_s(told: Input, at_s: Array, force_n: Array, longest_latency_s: float) -> float:
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
