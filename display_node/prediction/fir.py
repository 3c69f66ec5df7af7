"""A long-memory linear predictor: least squares over 1.3 s of taps and 30 s of data.

Recursive least squares gives the ridge solution of all data at every step, and needs no solve:
the gain of a regressor is the same for every horizon, so it is kept until the horizon's truth
arrives. Haykin, Adaptive Filter Theory, exponentially weighted RLS.
"""

import numpy as np
from scipy.linalg.blas import dger, dsymv, dsyr

from display_node.prediction.expert import FURTHEST, HORIZONS, SPACING, History, Trajectories

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
        """One trajectory (`Expert`)."""
        return np.asarray(np.einsum("ij,j->i", self._weights, self._regressor)[np.newaxis])

    def learn(self, history: History) -> None:
        """Correct every horizon's weights by the newest value; then count in its regressor."""
        if history.count >= REACH:
            self._correct(history.newest)
            self._keep_ridge()
            self._append()

    def _correct(self, newest: float) -> None:
        # The rows that foretold this value, the shortest horizon first.
        row = self._row
        foretold = slice(row - SPACING, row - FURTHEST - 1 if row > FURTHEST else None, -SPACING)
        predicted = np.einsum("ij,ij->i", self._weights, self._regressors[foretold])
        errors = newest - self._origins[foretold] - predicted
        self._weights += self._gains[foretold] * errors[:, np.newaxis]

    def _append(self) -> None:
        """Count the regressor into the covariance, and keep its gain."""
        regressor = self._regressor
        # BLAS on one triangle: the covariance cannot lose its symmetry.
        spread = dsymv(1.0, self._covariance, regressor)
        power = FORGET + float(regressor @ spread)
        dsyr(-1.0 / power, spread, a=self._covariance, overwrite_a=1)
        self._covariance *= 1 / FORGET
        np.divide(spread, power, out=self._gains[self._row])
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
        # In place: transposed, the weights are in the order that BLAS works in.
        dger(-1.0 / power, spread, self._weights[:, tap].copy(), a=self._weights.T, overwrite_a=1)
        dsyr(-1.0 / power, spread, a=self._covariance, overwrite_a=1)
