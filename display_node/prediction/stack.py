"""The stack: for every horizon, the weighting of the experts that would have been best.

Recursive least squares a horizon, on what was predicted when its truth arrives.
"""

import math

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import AHEAD, FURTHEST, HORIZONS

Floats = NDArray[np.float64]
MEMORY_STEPS = 2_000
FORGET = 1 - 1 / MEMORY_STEPS
RIDGE = 0.01
ERROR_MEMORY_STEPS = 400
HORIZON = np.arange(HORIZONS)


class Stack:
    """Combines n trajectories; starts at the weights it is given."""

    def __init__(self, trust: Floats) -> None:
        count = len(trust)
        self._trust = trust
        # By horizon: the covariance, and the weights as one more column of it.
        start = np.vstack([np.eye(count) / RIDGE, trust]).T
        self._state = np.tile(start, (HORIZONS, 1, 1))
        self._covariances, self._weights = self._state[:, :, :-1], self._state[:, :, -1]
        # What was predicted at the last steps, by step and horizon: inputs, output and origin.
        self._made = np.zeros((FURTHEST + 1, HORIZONS, count + 2))
        self._steps = 0
        self._power = np.zeros(HORIZONS)
        self._truths = 0

    def rms(self, horizon: int) -> float | None:
        """RMSE of the last predictions, 2 s or so, for a horizon from 0; None before any truth."""
        truths = self._truths - int(AHEAD[horizon])
        if truths <= 0:
            return None
        share = 1 - (1 - 1 / ERROR_MEMORY_STEPS) ** truths
        return math.sqrt(float(self._power[horizon]) / share)

    def predict(self, newest: float, trajectories: Floats) -> Floats:
        """Combine trajectories of shape (n, 25) from a newest value."""
        made = self._made[self._steps % len(self._made)]
        inputs, output = made[:, :-2], made[:, -2]
        inputs[:], made[:, -1] = trajectories.T, newest
        np.einsum("hi,hi->h", self._weights, inputs, out=output)
        self._steps += 1
        return np.asarray(output)

    def learn(self, newest: float) -> None:
        """After `predict`: the newest value is the truth of earlier predictions."""
        made = self._made[(self._steps - 1 - AHEAD) % len(self._made), HORIZON]
        inputs, outputs, origins = made[:, :-2], made[:, -2], made[:, -1]
        truths = newest - origins
        if self._steps <= FURTHEST:
            truths[self._steps <= AHEAD] = 0.0
        self._score(truths - outputs)
        spread = np.einsum("hij,hj->hi", self._covariances, inputs)
        power = FORGET + np.einsum("hi,hi->h", inputs, spread)
        self._correct(spread, power, truths - np.einsum("hi,hi->h", self._weights, inputs))
        self._covariances *= 1 / FORGET
        self._keep_ridge()

    def _keep_ridge(self) -> None:
        """Observe one weight a step, at its trust, as often as forgetting has to be made good."""
        expert = self._steps % len(self._trust)
        spread = self._covariances[:, :, expert].copy()
        power = 1 / (RIDGE * len(self._trust) * (1 - FORGET)) + spread[:, expert]
        self._correct(spread, power, self._trust[expert] - self._weights[:, expert])

    def _correct(self, spread: Floats, power: Floats, errors: Floats) -> None:
        gains = spread / power[:, np.newaxis]
        change = np.concatenate([spread, -errors[:, np.newaxis]], axis=1)
        self._state -= gains[:, :, np.newaxis] * change[:, np.newaxis, :]

    def _score(self, errors: Floats) -> None:
        self._truths += 1
        self._power += (errors * errors - self._power) / ERROR_MEMORY_STEPS
