"""A long linear filter that learns by recursive least squares.

References
----------
Haykin, Adaptive Filter Theory, exponentially weighted RLS.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import HORIZONS, SPACING, Expert, Floats
from display_node.prediction.history import NEVER, History, mean_about
from display_node.prediction.kernels import CUBE, FLOATS, ROWS, TABLE, kernel

# Inputs of the filter: the signal at the end of the newest cell and beyond, and means over steps
# one after the other, which become longer with their age: these are the steps to each side of their
# middle. More and shorter ones lower no error: they are more weights to learn.
ENDS: Final = 2
WIDTHS = np.array([0] * 8 + [1] * 4 + [2] * 4 + [4] * 4 + [8] * 12)
# Steps from the newest value to the middle of each mean.
LAGS = np.cumsum(2 * WIDTHS + 1) - WIDTHS
MEANS: Final = 32
REACH: Final = 281
TAPS: Final = MEANS + ENDS
# Forgetting factor for a memory of 2 400 steps of learning, some 30 s.
FORGET: Final = 1 - 1 / 2_400
# Relative to the power of the signal, as it is normalised.
RIDGE: Final = 0.005
# The forgotten part of the ridge is restored after this number of regressors.
RESTORED: Final = 4
# The covariance's factor is applied when it exceeds this.
LARGEST_FACTOR: Final = 1e3


@kernel(f"void({ROWS}, {FLOATS}, int64, {TABLE}, {FLOATS}, {CUBE}, {CUBE})")
def filter_newest(
    rows: NDArray[np.float32],
    sums: Floats,
    end: int,
    ahead: Floats,
    regressor: Floats,
    weights: Floats,
    made: Floats,
) -> None:
    """Write the regressor of the newest value, and each channel's trajectory (1, channels, 25).

    sums, ahead: as in `History`; of them, the first channel's are used.
    """
    newest = float(rows[0, end - 1])
    for tap in range(MEANS):
        regressor[tap] = mean_about(sums, end - 1 - LAGS[tap], WIDTHS[tap]) - newest
    for tap in range(ENDS):
        regressor[MEANS + tap] = ahead[0, tap] - newest
    for channel in range(len(weights)):
        path = made[0, channel]
        path[:] = 0.0
        for tap in range(TAPS):
            for horizon in range(HORIZONS):
                path[horizon] += regressor[tap] * weights[channel, tap, horizon]


@kernel(f"void({TABLE}, {CUBE}, {FLOATS}, {TABLE}, float64, float64)")
def correct(
    covariance: Floats, weights: Floats, spread: Floats, errors: Floats, power: float, factor: float
) -> None:
    """Correct weights and covariance by the errors (channels, 25) of a regressor.

    spread: the covariance times the regressor. power: the regressor's, with what is forgotten.
    factor: of the covariance.
    """
    for channel in range(len(weights)):
        error = errors[channel]
        for tap in range(TAPS):
            gain, row = spread[tap] / power, weights[channel, tap]
            for horizon in range(HORIZONS):
                row[horizon] += gain * error[horizon]
    for tap in range(TAPS):
        share, row = spread[tap] / (power * factor), covariance[tap]
        for other in range(TAPS):
            row[other] -= share * spread[other]


@kernel(f"void({ROWS}, int64, {FLOATS}, {CUBE}, {TABLE}, float64)")
def learn_regressor(
    rows: NDArray[np.float32],
    first: int,
    regressor: Floats,
    weights: Floats,
    covariance: Floats,
    factor: float,
) -> None:
    """Correct the weights by the regressor of the value `first` and the values that came since."""
    errors = np.empty((len(weights), HORIZONS))
    for channel in range(len(weights)):
        for horizon in range(HORIZONS):
            value = rows[channel, first + SPACING * (horizon + 1)]
            errors[channel, horizon] = value - rows[channel, first]
        for tap in range(TAPS):
            for horizon in range(HORIZONS):
                errors[channel, horizon] -= regressor[tap] * weights[channel, tap, horizon]
    spread = np.zeros(TAPS)
    for tap in range(TAPS):
        for other in range(TAPS):
            spread[other] += covariance[tap, other] * regressor[tap]
    power = FORGET
    for tap in range(TAPS):
        spread[tap] *= factor
        power += regressor[tap] * spread[tap]
    correct(covariance, weights, spread, errors, power, factor)


@kernel(f"void({CUBE}, {TABLE}, int64, float64)")
def keep_ridge(weights: Floats, covariance: Floats, tap: int, factor: float) -> None:
    """Observe one weight as 0, which restores the forgotten part of the ridge."""
    spread = factor * covariance[tap]
    power = 1 / (RIDGE * TAPS * RESTORED * (1 - FORGET)) + spread[tap]
    errors = np.empty((len(weights), HORIZONS))
    for channel in range(len(weights)):
        for horizon in range(HORIZONS):
            errors[channel, horizon] = -weights[channel, tap, horizon]
    correct(covariance, weights, spread, errors, power, factor)


class Fir(Expert):
    """x(t+h) − x(t) as a linear function of means over the past less x(t), for every horizon h.

    Recursive least squares gives the ridge solution of all data at every step without solving a
    system. A regressor is used when the values at all its horizons have come, 25 steps of learning
    later: then its gain is the same for every horizon, and values that late samples corrected are
    correct.
    """

    names: tuple[str, ...] = ("fir",)
    trust: tuple[float, ...] = (0.2,)

    def __init__(self, channels: int = 1) -> None:
        self._weights = np.zeros((channels, TAPS, HORIZONS))
        # The covariance over a factor, so that forgetting is no pass over it.
        self._covariance = np.eye(TAPS) / RIDGE
        self._factor = 1.0
        # Regressors of the last steps of learning with the history's count, and the newest one.
        self._regressors = np.zeros((HORIZONS, TAPS))
        self._counts = [NEVER] * HORIZONS
        self._regressor = np.zeros(TAPS)
        self._count = 0

    def predict(self, history: History, made: Floats) -> None:
        """Write the trajectory of the newest regressor."""
        if history.count < REACH:
            made[:] = 0.0
            return
        rows, end, regressor = history.buffer, history.end, self._regressor
        filter_newest(rows, history.sums, end, history.ahead, regressor, self._weights, made)

    def learn(self, history: History, artefact: bool = False) -> None:
        """Correct the weights by the oldest regressor, and store the newest one in its place."""
        if history.count < REACH:
            return
        place = self._count % HORIZONS
        regressor, first = self._regressors[place], history.place_of(self._counts[place])
        self._count += 1
        weights, covariance = self._weights, self._covariance
        if first >= 0 and not artefact:
            rows = history.buffer
            learn_regressor(rows, first, regressor, weights, covariance, self._factor)
            self._factor /= FORGET
            if self._count % RESTORED == 0:
                if self._factor > LARGEST_FACTOR:
                    covariance *= self._factor
                    self._factor = 1.0
                keep_ridge(weights, covariance, self._count // RESTORED % TAPS, self._factor)
        regressor[:] = self._regressor
        self._counts[place] = NEVER if artefact else history.count
