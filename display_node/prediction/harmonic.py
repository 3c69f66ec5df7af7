"""An extended Kalman filter of phase, frequency and harmonics.

    x(t) = m + Σ a_k cos kθ + b_k sin kθ,  θ ← θ + ω;  m, ω, a, b wander.

It starts at the rhythm's frequency, and is dropped when it diverges.

The rhythm: when beats began, by the slope's rise through a share of its usual peak.
"""

import math
import statistics

import numpy as np

from display_node.prediction.expert import AHEAD, HORIZONS, History, Trajectories

BEATS = 9
FEWEST = 4
SHARE = 0.45
# Two beats are at least so many steps apart: 250 ms.
REFRACTORY = 50
# Before peaks are known: the highest slope yet, which fades with a time constant of 3 s.
FADE = 1 - 1 / 600


class Rhythm:
    """Follows the beats of a signal on the grid.

    interval: the median of the last beats' intervals in steps; None before there are any.
    """

    def __init__(self) -> None:
        self.interval: float | None = None
        self._intervals: list[int] = []
        self._peaks: list[float] = []
        self._peak = self._highest = self._slope = 0.0
        self._threshold = float("inf")
        self._step = 0
        self._beat_step: int | None = None

    def push(self, slope: float) -> None:
        """Take the slope at the next step."""
        self._step += 1
        rested = self._beat_step is None or self._step - self._beat_step > REFRACTORY
        if self._slope < self._threshold <= slope and rested:
            self._beat()
        self._slope = slope
        self._peak = max(self._peak, slope)
        self._highest = max(self._highest * FADE, slope)
        if self.interval is None and self._highest > 0:
            self._threshold = SHARE * self._highest

    def _beat(self) -> None:
        if self._beat_step is not None:
            self._peaks = [*self._peaks[1 - BEATS :], self._peak]
            self._intervals = [*self._intervals[1 - BEATS :], self._step - self._beat_step]
            if len(self._peaks) >= FEWEST:
                self._threshold = SHARE * statistics.median(self._peaks)
                self.interval = statistics.median(self._intervals)
        self._peak = 0.0
        self._beat_step = self._step


HARMONICS = 8
# Of the cosines and then of the sines, which are cosines a quarter later.
ORDER = np.tile(np.arange(1.0, HARMONICS + 1), 2)
LATER = np.repeat([0.0, np.pi / 2], HARMONICS)
# Per step, in units of the signal's standard deviation: noise, and what wanders.
NOISE = 0.05
WANDER = 0.01
PHASE_WANDER = 0.01
FREQUENCY_WANDER = 3e-5
# Diverged: the running mean square of its surprise is above this share of the signal's power.
DIVERGED = 0.5
PATIENCE_STEPS = 400
SIZE = 3 + 2 * HARMONICS


class Harmonic:
    """One trajectory. alive: it has started and has not diverged."""

    names: tuple[str, ...] = ("harmonic",)
    trust = 0.0

    def __init__(self, rhythm: Rhythm) -> None:
        self._rhythm = rhythm
        self._wander = np.diag(
            [PHASE_WANDER**2, FREQUENCY_WANDER**2, WANDER**2] + [WANDER**2 / 4] * 2 * HARMONICS
        )
        self._sensitivity = np.zeros(SIZE)
        self._sensitivity[2] = 1.0
        self._drop()

    def _drop(self) -> None:
        self.alive = False
        self._surprise = 0.0
        self._age = 0

    def _start(self, newest: float, interval: float) -> None:
        self.alive = True
        self._state = np.zeros(SIZE)
        self._state[1], self._state[2] = 2 * np.pi / interval, newest
        spread = np.full(SIZE, 1.0)
        spread[0], spread[1] = 0.0, (0.05 * self._state[1]) ** 2
        self._covariance = np.diag(spread)

    def observe(self, history: History) -> None:
        """Nothing: the state is so slow that it predicts from a step before, and is learnt last."""

    def predict(self, history: History) -> Trajectories:
        """One trajectory (`Expert`)."""
        if not self.alive:
            return np.zeros((1, HORIZONS))
        return np.asarray((self._ahead - history.newest)[np.newaxis])

    def learn(self, history: History) -> None:
        """Correct the state by the newest value; start, or drop it, where that is due."""
        newest, interval = history.newest, self._rhythm.interval
        if interval is None:
            return
        if not self.alive:
            self._start(newest, interval)
        self._follow(newest)
        if not self._sane(interval):
            self._drop()
            return
        state = self._state
        # What `predict` will be asked for at the next step.
        angles = np.multiply.outer(state[0] + (1 + AHEAD) * state[1], ORDER) - LATER
        self._ahead = state[2] + np.cos(angles) @ state[3:]

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

    def _sane(self, interval: float) -> bool:
        if not math.isfinite(self._state.dot(self._state)):
            return False
        beats_a_turn = float(self._state[1]) * interval / (2 * np.pi)
        if not 0.4 < beats_a_turn < 2.5:
            return False
        return self._age < PATIENCE_STEPS or self._surprise < DIVERGED
