"""The experts of the stack: beat analogues, a long linear filter, and a harmonic oscillator.

Each expert predicts the history's values at `HORIZONS` common horizons up to 250 ms ahead. The
package's docstring lists the places to change when you add a predictor.
"""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dger, dsymv, dsyr

from display_node.prediction.grid import History, Rhythm

# The horizons are 10 ms apart, up to 250 ms, and a cubic joins them: the pulse ends below 40 Hz.
SPACING, HORIZONS = 2, 25
AHEAD = SPACING * np.arange(1, HORIZONS + 1)
FURTHEST = SPACING * HORIZONS
Trajectories = NDArray[np.float64]


class Expert(Protocol):
    """Predictor of a history's values `AHEAD` steps after the newest, as one or more trajectories.

    names: of its trajectories. trust: weight of each of them at the stack's start.
    """

    names: tuple[str, ...]
    trust: tuple[float, ...]

    def observe(self, history: History) -> None:
        """Take the newest value of the history; call once after each push."""
        return

    def predict(self, history: History) -> Trajectories:
        """Return the predicted differences from the newest value, shape (names, 25).

        Call it after `observe`. Zeros, which hold the newest value, mean that the expert has not
        learnt enough.
        """

    def learn(self, history: History) -> None:
        """Learn from the newest value; call it after `predict`, which need not wait for it."""
        return


LAGS = 8_000
# Smallest lag. At smaller ones, the next 250 ms are not known yet, or the beat is the present one.
NEAREST = 60
MEMORIES_S = (0.05, 0.2, 0.6)
STEP_S = 0.005
# Weight of the slope (per step): the ratio of a pulse's power to that of its slope, so that both
# count about equally.
SLOPE = 50.0
ANALOGUES = 15
# Kernel's width over the analogues' mean distance.
KERNEL = 0.2
# Share of the analogue's difference from the present value that its continuation is reduced by.
OFFSET = 0.5
# A lag is used after its distance has been summed over this number of steps. The longer memories
# then still contain zeros from before the start, which make old lags less similar, not more.
SETTLED = 20
# Steps from an analogue to the values that follow it; 0 is the analogue itself.
NEXT = np.concatenate([[0], AHEAD])
MEMORY = np.arange(len(MEMORIES_S))[:, np.newaxis]


class Analogue(Expert):
    """Mean continuation of the moments of the last 40 s that are most similar to the present.

    There is one trajectory for each memory λ. The present's distance from each lag l is updated by

        D(l) ← λ D(l) + (x(t) − x(t−l))² + w (ẋ(t) − ẋ(t−l))²,

    and its lowest local minima are the analogues.

    References
    ----------
    Lorenz (1969), analogues as predictors.
    """

    trust: tuple[float, ...] = (0.6, 0.2, 0.0)

    def __init__(self) -> None:
        self.names: tuple[str, ...] = tuple(f"analogue {memory_s:g} s" for memory_s in MEMORIES_S)
        # Oldest first, like the history: index i is the lag LAGS − i. Single precision saves time
        # in these long rows; their noise exceeds its rounding.
        self._difference = np.zeros(LAGS, np.float32)
        self._step = np.zeros(LAGS, np.float32)
        self._distances = np.zeros((len(MEMORIES_S), LAGS), np.float32)
        self._places: NDArray[np.intp] | None = None
        self._forget = np.exp(-STEP_S / np.array(MEMORIES_S, np.float32))[:, np.newaxis]

    def observe(self, history: History) -> None:
        """Update the distances and find the analogues."""
        past = history.last(LAGS + 1)
        # The slopes' difference is the change of the values' difference since the last step.
        difference, step = self._step, self._difference
        np.subtract(past[:-1], past[-1], out=difference)
        step -= difference
        self._difference, self._step = difference, step
        step *= step
        step *= SLOPE
        step += difference * difference
        self._distances *= self._forget
        self._distances += step
        first = LAGS - min(LAGS, history.count - SETTLED)
        self._places = None
        if first < LAGS - NEAREST - 2:
            places = _lowest_minima(self._distances[:, first : LAGS - NEAREST + 1])
            self._places = None if places is None else first + places

    def predict(self, history: History) -> Trajectories:
        """Return a trajectory for each memory: the mean continuation of its analogues."""
        places, past = self._places, history.last(LAGS + 1)
        if places is None:
            return np.zeros((len(MEMORIES_S), HORIZONS))
        nearest = self._distances[MEMORY, places]
        # The small constant keeps the width above 0 where all distances are 0.
        width = KERNEL / ANALOGUES * np.add.reduce(nearest, axis=1, keepdims=True) + 1e-30
        weights = np.exp((np.minimum.reduce(nearest, axis=1, keepdims=True) - nearest) / width)
        weights /= np.add.reduce(weights, axis=1, keepdims=True)
        ahead = past.take(places[:, :, np.newaxis] + NEXT)
        followed = (weights[:, np.newaxis] @ ahead)[:, 0] - past[-1]
        return np.asarray(followed[:, 1:] - OFFSET * followed[:, :1], np.float64)


def _lowest_minima(distances: NDArray[np.float32]) -> NDArray[np.intp] | None:
    """Return the positions of each row's ANALOGUES lowest local minima.

    Fewer minima are repeated. Returns None where a row has no minimum.
    """
    middle = distances[:, 1:-1]
    is_lowest = middle < distances[:, :-2]
    is_lowest &= middle <= distances[:, 2:]
    places = np.empty((len(distances), ANALOGUES), np.intp)
    for row, chosen in enumerate(is_lowest):
        (at,) = chosen.nonzero()
        if len(at) > ANALOGUES:
            at = at[middle[row, at].argpartition(ANALOGUES)[:ANALOGUES]]
        elif not len(at):
            return None
        places[row] = np.resize(at, ANALOGUES) if len(at) < ANALOGUES else at
    places += 1
    return places


# Taps of the filter: the near past at every step, and further back, to 1.3 s, means over STRIDE.
NEAR, FAR, STRIDE = 40, 55, 4
REACH = NEAR + FAR * STRIDE + 1
TAPS = NEAR + FAR
# Forgetting factor for a memory of 30 s.
FORGET = 1 - 1 / 6_000
# Relative to the power of the signal, as it is normalised.
RIDGE = 0.01
ROWS = 8 * FURTHEST


class Fir(Expert):
    """x(t+h) − x(t) as a linear function of x(t−i) − x(t), for every horizon h.

    Recursive least squares gives the ridge solution of all data at every step without solving a
    system. The gain of a regressor is the same for every horizon, and is kept until the true value
    at that horizon arrives.

    References
    ----------
    Haykin, Adaptive Filter Theory, exponentially weighted RLS.
    """

    names: tuple[str, ...] = ("fir",)
    trust: tuple[float, ...] = (0.2,)

    def __init__(self) -> None:
        self._weights = np.zeros((HORIZONS, TAPS))
        self._covariance = np.asfortranarray(np.eye(TAPS) / RIDGE)
        # Regressors, their gains, and the newest values at their time; FURTHEST rows are in use.
        self._regressors = np.zeros((ROWS, TAPS))
        self._gains = np.zeros((ROWS, TAPS))
        self._origins = np.zeros(ROWS)
        self._row = FURTHEST
        self._tap = 0
        self._regressor = self._regressors[self._row]

    def observe(self, history: History) -> None:
        """Take the next regressor."""
        if history.count < REACH:
            return
        newest, past = history.newest, history.last(REACH)
        regressor = self._regressor = self._regressors[self._row]
        far = past[: FAR * STRIDE].reshape(FAR, STRIDE)
        np.multiply(np.add.reduce(far, axis=1), 1 / STRIDE, out=regressor[:FAR])
        regressor[FAR:] = past[FAR * STRIDE : -1]
        regressor -= newest
        self._origins[self._row] = newest

    def predict(self, history: History) -> Trajectories:
        """Return the trajectory of the newest regressor."""
        return np.asarray(np.einsum("ij,j->i", self._weights, self._regressor)[np.newaxis])

    def learn(self, history: History) -> None:
        """Correct every horizon's weights by the newest value, and add the newest regressor."""
        if history.count < REACH:
            return
        # The rows that predicted this value, the shortest horizon first.
        row = self._row
        before = slice(row - SPACING, row - FURTHEST - 1 if row > FURTHEST else None, -SPACING)
        predicted = np.einsum("ij,ij->i", self._weights, self._regressors[before])
        errors = history.newest - self._origins[before] - predicted
        self._weights += self._gains[before] * errors[:, np.newaxis]
        self._keep_ridge()
        regressor = self._regressor
        # BLAS works on one triangle, so the covariance stays symmetric.
        spread = dsymv(1.0, self._covariance, regressor)
        power = FORGET + float(regressor @ spread)
        dsyr(-1.0 / power, spread, a=self._covariance, overwrite_a=1)
        self._covariance *= 1 / FORGET
        np.divide(spread, power, out=self._gains[row])
        self._row += 1
        if self._row == ROWS:
            for rows in (self._regressors, self._gains, self._origins):
                rows[:FURTHEST] = rows[-FURTHEST:]
            self._row = FURTHEST

    def _keep_ridge(self) -> None:
        """Observe one weight a step as 0, which restores the forgotten part of the ridge."""
        tap = self._tap = (self._tap + 1) % TAPS
        spread = np.concatenate([self._covariance[:tap, tap], self._covariance[tap, tap:]])
        power = 1 / (RIDGE * TAPS * (1 - FORGET)) + spread[tap]
        # In place: the transposed weights have the memory order of BLAS.
        dger(-1.0 / power, spread, self._weights[:, tap].copy(), a=self._weights.T, overwrite_a=1)
        dsyr(-1.0 / power, spread, a=self._covariance, overwrite_a=1)


HARMONICS = 8
SIZE = 3 + 2 * HARMONICS
# Order and phase of each harmonic: the cosines, then the sines as cosines with a phase of π/2.
ORDER = np.tile(np.arange(1.0, HARMONICS + 1), 2)
LATER = np.repeat([0.0, np.pi / 2], HARMONICS)
# Noise and random walk per step, in units of the signal's standard deviation.
NOISE, WANDER = 0.05, 0.01
PHASE_WANDER, FREQUENCY_WANDER = 0.01, 3e-5
# The filter has diverged if its mean square error is above this share of the signal's power.
DIVERGED = 0.5
PATIENCE_STEPS = 400


class Harmonic(Expert):
    """One trajectory, of an extended Kalman filter of phase, frequency and harmonics.

        x(t) = m + Σ a_k cos kθ + b_k sin kθ,  θ ← θ + ω;  m, ω, a, b walk randomly.

    It starts at the rhythm's frequency, and is restarted when it diverges. The state changes so
    slowly that a prediction from the state of one step before suffices. alive: whether it has
    started and has not diverged.
    """

    names: tuple[str, ...] = ("harmonic",)
    trust: tuple[float, ...] = (0.0,)

    def __init__(self, rhythm: Rhythm) -> None:
        self._rhythm = rhythm
        self._wander = np.diag(
            [PHASE_WANDER**2, FREQUENCY_WANDER**2, WANDER**2] + [WANDER**2 / 4] * 2 * HARMONICS
        )
        self._sensitivity = np.zeros(SIZE)
        self._sensitivity[2] = 1.0
        self.alive = False

    def predict(self, history: History) -> Trajectories:
        """Return the oscillator's trajectory."""
        if not self.alive:
            return np.zeros((1, HORIZONS))
        return np.asarray((self._ahead - history.newest)[np.newaxis])

    def learn(self, history: History) -> None:
        """Correct the state by the newest value; start it, or drop it after divergence."""
        newest, interval = history.newest, self._rhythm.interval
        if interval is None:
            self.alive = False
            return
        if not self.alive:
            self._start(newest, interval)
        self._follow(newest)
        self.alive = self._converges(interval)
        if self.alive:
            state = self._state
            # The values that `predict` returns at the next step.
            angles = np.multiply.outer(state[0] + (1 + AHEAD) * state[1], ORDER) - LATER
            self._ahead = state[2] + np.cos(angles) @ state[3:]

    def _start(self, newest: float, interval: float) -> None:
        self._surprise, self._age = 0.0, 0
        self._state = np.zeros(SIZE)
        self._state[1], self._state[2] = 2 * np.pi / interval, newest
        spread = np.full(SIZE, 1.0)
        spread[0], spread[1] = 0.0, (0.05 * self._state[1]) ** 2
        self._covariance = np.diag(spread)

    def _follow(self, newest: float) -> None:
        state, covariance = self._state, self._covariance
        state[0] = (state[0] + state[1]) % (2 * np.pi)
        covariance[0] += covariance[1]
        covariance[:, 0] += covariance[:, 1]
        covariance += self._wander
        angles = ORDER * state[0] - LATER
        sensitivity = self._sensitivity
        sensitivity[0] = -float((ORDER * np.sin(angles)) @ state[3:])
        sensitivity[3:] = np.cos(angles)
        surprise = newest - float(sensitivity[2:] @ state[2:])
        spread = covariance @ sensitivity
        power = NOISE**2 + float(sensitivity @ spread)
        state += spread * (surprise / power)
        covariance -= np.multiply.outer(spread / power, spread)
        self._surprise += (surprise * surprise - self._surprise) / PATIENCE_STEPS
        self._age += 1

    def _converges(self, interval: float) -> bool:
        if not math.isfinite(self._state.dot(self._state)):
            return False
        beats_a_turn = float(self._state[1]) * interval / (2 * np.pi)
        if not 0.4 < beats_a_turn < 2.5:
            return False
        return self._age < PATIENCE_STEPS or self._surprise < DIVERGED
