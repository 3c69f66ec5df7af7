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


class Stack:
    """Combines n trajectories; starts at the weights it is given."""

    def __init__(self, trust: Floats) -> None:
        count = len(trust)
        self._trust = trust
        self._weights = np.tile(trust, (HORIZONS, 1))
        self._covariances = np.tile(np.eye(count) / RIDGE, (HORIZONS, 1, 1))
        # What was predicted at the last steps, by step, horizon and expert.
        self._rows = FURTHEST + 1
        self._inputs = np.zeros((self._rows, HORIZONS, count))
        self._outputs = np.zeros((self._rows, HORIZONS))
        self._origins = np.zeros(self._rows)
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
        row = self._steps % self._rows
        self._inputs[row] = trajectories.T
        self._origins[row] = newest
        self._steps += 1
        self._outputs[row] = np.einsum("hi,hi->h", self._weights, self._inputs[row])
        return np.asarray(self._outputs[row])

    def learn(self, newest: float) -> None:
        """After `predict`: the newest value is the truth of earlier predictions."""
        rows = (self._steps - 1 - AHEAD) % self._rows
        horizon = np.arange(HORIZONS)
        inputs = self._inputs[rows, horizon]
        known = self._steps > AHEAD
        truths = np.where(known, newest - self._origins[rows], 0.0)
        self._score(truths - np.where(known, self._outputs[rows, horizon], 0.0))
        spread = np.einsum("hij,hj->hi", self._covariances, inputs)
        power = FORGET + np.einsum("hi,hi->h", inputs, spread)
        self._correct(spread, power, truths - np.einsum("hi,hi->h", self._weights, inputs))
        self._covariances *= 1 / FORGET
        self._keep_ridge()

    def _keep_ridge(self) -> None:
        """Observe one weight a step, at its trust, as often as forgetting has to be made good."""
        expert = self._steps % len(self._trust)
        spread = self._covariances[:, :, expert]
        power = 1 / (RIDGE * len(self._trust) * (1 - FORGET)) + spread[:, expert]
        self._correct(spread, power, self._trust[expert] - self._weights[:, expert])

    def _correct(self, spread: Floats, power: Floats, errors: Floats) -> None:
        gains = spread / power[:, np.newaxis]
        self._weights += gains * errors[:, np.newaxis]
        self._covariances -= gains[:, :, np.newaxis] * spread[:, np.newaxis, :]

    def _score(self, errors: Floats) -> None:
        self._truths += 1
        self._power += (errors * errors - self._power) / ERROR_MEMORY_STEPS
