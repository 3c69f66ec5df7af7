"""A long-memory linear predictor: least squares over 1.3 s of taps and 30 s of data.

Recursive least squares gives the ridge solution of all data at every step, and needs no solve:
the gain of a regressor is the same for every horizon, so it is kept until the horizon's truth
arrives. Haykin, Adaptive Filter Theory, exponentially weighted RLS.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsymv, dsyr

from display_node.prediction.expert import FURTHEST, HORIZONS, SPACING, Trajectories
from display_node.prediction.history import History

# The near past at every step; further back, means over STRIDE steps: 1.3 s.
NEAR, FAR, STRIDE = 40, 55, 4
REACH = NEAR + FAR * STRIDE + 1
TAPS = NEAR + FAR
MEMORY_STEPS = 6_000
FORGET = 1 - 1 / MEMORY_STEPS
# Relative to the power of the signal, as it is normalised.
RIDGE = 0.01
ROWS = 8 * FURTHEST


class Fir:
    """x(t+h) − x(t) as a linear function of x(t−i) − x(t), for every horizon h."""

    names: tuple[str, ...] = ("fir",)
    trust = 0.4

    def __init__(self) -> None:
        self._weights = np.zeros((HORIZONS, TAPS))
        self._covariance = np.asfortranarray(np.eye(TAPS) / RIDGE)
        # Regressors, their gains and the values they came from; the last FURTHEST rows count.
        self._regressors = np.zeros((ROWS, TAPS))
        self._gains = np.zeros((ROWS, TAPS))
        self._origins = np.zeros(ROWS)
        self._row = FURTHEST
        self._tap = 0
        self._regressor = np.zeros(TAPS)

    def observe(self, history: History) -> None:
        """Correct every horizon's weights by the newest value; then take the next regressor."""
        if history.count < REACH:
            return
        row, newest = self._row, history.newest
        # The rows that foretold this value, the shortest horizon first.
        foretold = slice(row - SPACING, row - FURTHEST - 1 if row > FURTHEST else None, -SPACING)
        predicted = np.einsum("ij,ij->i", self._weights, self._regressors[foretold])
        errors = newest - self._origins[foretold] - predicted
        self._weights += self._gains[foretold] * errors[:, np.newaxis]
        self._keep_ridge()
        past = history.last(REACH)
        far = past[: FAR * STRIDE].reshape(FAR, STRIDE).sum(axis=1) / STRIDE
        self._regressor = np.concatenate([far, past[FAR * STRIDE : -1]]) - newest
        self._append(self._regressor, newest)

    def predict(self, history: History) -> Trajectories:
        """One trajectory (`Expert`)."""
        return np.asarray(np.einsum("ij,j->i", self._weights, self._regressor)[np.newaxis])

    def _append(self, regressor: NDArray[np.float64], newest: float) -> None:
        """Keep a regressor with its gain, and count it into the covariance."""
        # BLAS on one triangle: the covariance cannot lose its symmetry.
        spread = dsymv(1.0, self._covariance, regressor)
        power = FORGET + float(regressor @ spread)
        dsyr(-1.0 / power, spread, a=self._covariance, overwrite_a=1)
        self._covariance *= 1 / FORGET
        row = self._row
        self._regressors[row], self._origins[row] = regressor, newest
        np.divide(spread, power, out=self._gains[row])
        self._row += 1
        if self._row == ROWS:
            for rows in (self._regressors, self._gains, self._origins):
                rows[:FURTHEST] = rows[-FURTHEST:]
            self._row = FURTHEST

    def _keep_ridge(self) -> None:
        """Observe one weight a step, as 0, as often as forgetting has to be made good."""
        tap = self._tap = (self._tap + 1) % TAPS
        spread = np.concatenate([self._covariance[:tap, tap], self._covariance[tap, tap:]])
        power = 1 / (RIDGE * TAPS * (1 - FORGET)) + spread[tap]
        self._weights -= np.multiply.outer(self._weights[:, tap], spread / power)
        dsyr(-1.0 / power, spread, a=self._covariance, overwrite_a=1)
