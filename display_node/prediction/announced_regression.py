"""The path of the pulse after an R wave, regressed among the beats of the last 40 s.

The analogues of the present are the moments that lay as long after their own R wave. Among them a
ridge regression of what followed on what preceded is a linear filter for this moment of the beat,
as the regression among the most similar moments is (`experts.py`); but these analogues are the
right ones also before the pulse shows the next beat.

How the heart fills, and so how strong and long a beat is, follows from the R-R interval before it.
The pulse shows that interval late; the R waves show it at once, so it is an input of its own.

References
----------
Rawles (1988), A mathematical model of left ventricular function in atrial fibrillation: the stroke
volume as a function of the two R-R intervals before the beat.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import FURTHEST, HORIZONS, SPACING, Floats
from display_node.prediction.history import History
from display_node.prediction.kernels import FLOATS, PLACES, ROWS, TABLE, bounded, kernel
from display_node.prediction.ridge import solve_ridge
from display_node.prediction.transit import INTERVALS, Analogues, TransitTime

Places = NDArray[np.int64]
Row = NDArray[np.float32]

# Lags of the regression's inputs: fewer than among similar moments, since each beat is one
# analogue.
LOCAL = np.array([1, 2, 3, 4, 6, 8, 11, 14, 18, 24, 32, 40, 60, 100])
DEEPEST: Final = 100
# One regression serves the next steps, and is made for the middle of them. Their number follows how
# fast the gains change: most within RISING steps of the arrival, least from PASSED steps after it.
FEWEST_STEPS: Final = 2
USUAL_STEPS: Final = 4
STEPS: Final = 8
RISING, PASSED = 10.0, 60.0
# Steps back to the oldest value that is used: 40 s, and from the present to each input.
REACH: Final = 8_000
# Number of the last analogues that are used, the least number of them, and the one up to which
# shorter pauses than the present one count.
MOST, FEWEST, ENOUGH = 60, 4, 8
NEAREST, FARTHEST = FURTHEST + STEPS + 1, REACH - DEEPEST
# Width of their kernel over their mean distance: until the pulse arrives, and from then on, when it
# shows which beats are like the present one.
EARLY_WIDTH, WIDTH = 1.0, 0.5
# An R-R interval's difference of 150 ms counts as a deviation of the pulse; in the distances, that
# of the last one counts as much as this number of inputs. From 10 to 100, the errors are the same.
INTERVAL_STEPS = 30.0
INTERVAL_WEIGHT: Final = 30.0
# Number of the inputs from the pulse, and with those from the R-R intervals.
PULSE: Final = 14
INPUTS: Final = PULSE + INTERVALS
# Strength of gains of 0: the beat before, more than 120 ms ago, has a smaller part in what follows.
RIDGE = np.repeat([0.003, 0.1, 0.01], (10, PULSE - 10, INTERVALS))


@kernel(f"void({ROWS}, int64, {PLACES}, {TABLE}, float64, {FLOATS})")
def weigh_moments(
    rows: Row, end: int, lags: Places, intervals: Floats, width: float, weights: Floats
) -> None:
    """Write the weights of the moments, which fall with the distance and add up to 1.

    intervals: differences of their R-R intervals from the present's. width: of the kernel, over the
    mean distance.
    """
    row, present, count = rows[0], end - 1, len(lags)
    total = 0.0
    for number in range(count):
        at = present - lags[number]
        distance = INTERVAL_WEIGHT * intervals[number, 0] ** 2
        for tap in range(PULSE):
            apart = row[at - LOCAL[tap]] - row[at] - (row[present - LOCAL[tap]] - row[present])
            distance += apart * apart
        weights[number] = distance
        total += distance
    scale = count / (width * total + 1e-30)
    nearest = weights[:count].min()
    total = 0.0
    for number in range(count):
        weights[number] = math.exp(scale * (nearest - weights[number]))
        total += weights[number]
    for number in range(count):
        weights[number] /= total


@kernel(f"boolean({ROWS}, int64, {PLACES}, {TABLE}, {FLOATS}, int64, {TABLE}, {FLOATS}, {FLOATS})")
def regress_moments(
    rows: Row,
    end: int,
    lags: Places,
    intervals: Floats,
    weights: Floats,
    later: int,
    gains: Floats,
    low: Floats,
    high: Floats,
) -> bool:
    """Regress what followed the moments on what preceded them; return whether it succeeded.

    later: the steps after each moment for which it is made. gains: where to write the regression's,
    shape (inputs, channels × 25). low, high: where to write the range of what followed.
    """
    channels, count, outputs = len(rows), len(lags), len(low)
    taps = np.empty((count, INPUTS))
    mean = np.zeros(INPUTS)
    for number in range(count):
        at = end - 1 - lags[number] + later
        for tap in range(PULSE):
            taps[number, tap] = rows[0, at - LOCAL[tap]] - rows[0, at]
        for interval in range(INTERVALS):
            taps[number, PULSE + interval] = intervals[number, interval]
        for tap in range(INPUTS):
            mean[tap] += weights[number] * taps[number, tap]
    squares = np.zeros((INPUTS, INPUTS))
    followed = np.empty(outputs)
    gains[:] = 0.0
    low[:], high[:] = math.inf, -math.inf
    for number in range(count):
        at = end - 1 - lags[number] + later
        for channel in range(channels):
            row, begin = rows[channel], channel * HORIZONS
            for horizon in range(HORIZONS):
                followed[begin + horizon] = row[at + SPACING * (horizon + 1)] - row[at]
        for output in range(outputs):
            low[output] = min(low[output], followed[output])
            high[output] = max(high[output], followed[output])
        inputs = taps[number]
        for tap in range(INPUTS):
            inputs[tap] -= mean[tap]
        for tap in range(INPUTS):
            weighted, square, product = weights[number] * inputs[tap], squares[tap], gains[tap]
            for other in range(tap + 1):
                square[other] += weighted * inputs[other]
            for output in range(outputs):
                product[output] += weighted * followed[output]
    for tap in range(INPUTS):
        squares[tap, tap] += RIDGE[tap]
    return bool(solve_ridge(squares, gains))


@kernel(f"void({ROWS}, int64, {PLACES}, {TABLE}, {FLOATS}, {TABLE}, {TABLE})")
def continue_moments(
    rows: Row,
    end: int,
    lags: Places,
    intervals: Floats,
    weights: Floats,
    gains: Floats,
    constants: Floats,
) -> None:
    """Write what the next steps' paths are for inputs of 0, shape (steps, channels × 25).

    That is the moments' mean continuation less what their mean inputs add. The intervals are
    differences from the present's, whose own input is so 0.
    """
    constants[:] = 0.0
    inputs = np.empty(INPUTS)
    for step in range(len(constants)):
        constant = constants[step]
        inputs[:] = 0.0
        for number in range(len(lags)):
            weight, at = weights[number], end - lags[number] + step
            for channel in range(len(rows)):
                row, begin = rows[channel], channel * HORIZONS
                for horizon in range(HORIZONS):
                    followed = row[at + SPACING * (horizon + 1)] - row[at]
                    constant[begin + horizon] += weight * followed
            for tap in range(PULSE):
                inputs[tap] += weight * (rows[0, at - LOCAL[tap]] - rows[0, at])
            for interval in range(INTERVALS):
                inputs[PULSE + interval] += weight * intervals[number, interval]
        for tap in range(INPUTS):
            gain = gains[tap]
            for output in range(len(constant)):
                constant[output] -= inputs[tap] * gain[output]


@kernel(f"void({ROWS}, int64, {FLOATS}, {TABLE}, {FLOATS}, {FLOATS}, {TABLE})")
def follow_moments(
    rows: Row,
    end: int,
    constant: Floats,
    gains: Floats,
    low: Floats,
    high: Floats,
    paths: Floats,
) -> None:
    """Write the path of each channel, shape (channels, 25), from the present's inputs."""
    row, present = rows[0], end - 1
    for channel in range(len(rows)):
        begin, path = channel * HORIZONS, paths[channel]
        for horizon in range(HORIZONS):
            path[horizon] = constant[begin + horizon]
        for tap in range(PULSE):
            value, gain = row[present - LOCAL[tap]] - row[present], gains[tap]
            for horizon in range(HORIZONS):
                path[horizon] += value * gain[begin + horizon]
        for horizon in range(HORIZONS):
            # A present unlike all its analogues is not extrapolated beyond them.
            within = bounded(path[horizon], low[begin + horizon], high[begin + horizon])
            path[horizon] = within + rows[channel, present]


class AnnouncedRegression:
    """Regression among the moments as long after their R wave as the present is.

    unprecedented: whether the present pause is longer than any before.
    """

    def __init__(self, transit: TransitTime, channels: int = 1) -> None:
        self.unprecedented = False
        self._transit = transit
        # The paths of the next steps from inputs of 0, of all channels side by side; how many there
        # are, and how many of them are left.
        self._constants = np.zeros((STEPS, channels * HORIZONS))
        self._steps = self._left = 0
        self._gains = np.zeros((INPUTS, channels * HORIZONS))
        self._low, self._high = np.zeros((2, channels * HORIZONS))
        self._weights = np.zeros(MOST)
        self._newest_wave = 0.0
        # Of the R waves that are analogues: when the next ones were found, in order of size; their
        # R-R intervals; and the moments after them until the first of the next ones was found.
        self._analogues: Analogues | None = None
        self._until = np.zeros(0)
        self._scaled: Floats = np.zeros((0, INTERVALS))
        self._usual: tuple[Places, Floats] = np.zeros(0, np.int64), self._scaled

    def predict(self, history: History, paths: Floats) -> bool:
        """Write the path of each channel, shape (channels, 25).

        Returns False, and writes nothing, where too few beats are analogues.
        """
        if not self._left:
            return False
        constant = self._constants[self._steps - self._left]
        self._left -= 1
        rows, end = history.buffer, history.end
        follow_moments(rows, end, constant, self._gains, self._low, self._high, paths)
        return True

    def prepare(self, history: History) -> None:
        """Find the analogues of the next steps, and make the regression for them, when it is due.

        It is due when that before has served, and when the newest R wave is a new one. Call it at
        every second step.
        """
        newest_wave = self._transit.newest
        if self._left >= SPACING and newest_wave == self._newest_wave:
            return
        self._newest_wave, self._left = newest_wave, 0
        lags, intervals = self._moments(history.count)
        if len(lags) < FEWEST:
            return
        since, arrives = history.count - newest_wave, self._transit.median or 0.0
        width = EARLY_WIDTH if since < arrives else WIDTH
        moments = history.buffer, history.end, lags, intervals
        weigh_moments(*moments, width, self._weights)
        steps, gains = _steps(since - arrives), self._gains
        if regress_moments(*moments, self._weights, steps // 2, gains, self._low, self._high):
            constants = self._constants[:steps]
            continue_moments(*moments, self._weights, gains, constants)
            self._steps = self._left = steps

    def _moments(self, count: int) -> tuple[Places, Floats]:
        """Return the last moments as long after their R wave as the present is.

        They are given by their lags, and the differences of their R-R intervals from the present's.
        """
        analogues = self._transit.analogues
        if analogues is not self._analogues:
            self._analogues = analogues
            self._until = np.sort(analogues.lengths)
            self._scaled = np.ascontiguousarray(analogues.intervals / INTERVAL_STEPS)
            self._usual = self._chosen(analogues.lags, analogues.lags > 0, count)
        since, until = count - analogues.newest, analogues.lengths
        self.unprecedented = not len(until) or since >= self._until[-1]
        if not len(until) or since < self._until[0]:
            return self._usual
        # At such a moment, the next R wave had not been found yet. In a pause as long as few or
        # none before, they are the ends of the longest ones, after which no beat was near either.
        over = np.where(until > since, 0.0, since + STEPS + 1 - until)
        lags = analogues.lags + np.rint(over).astype(np.int64)
        return self._chosen(lags, over <= np.sort(over)[:ENOUGH][-1], count)

    def _chosen(self, lags: Places, chosen: NDArray[np.bool_], count: int) -> tuple[Places, Floats]:
        """Return the last of the chosen moments whose windows lie within the history."""
        longest = min(FARTHEST, count - (REACH - FARTHEST))
        chosen &= (lags >= NEAREST) & (lags < longest)
        return lags[chosen][-MOST:], self._scaled[chosen][-MOST:]


def _steps(since_arrival: float) -> int:
    """Return the number of steps that a regression serves, from a time after the arrival."""
    if since_arrival >= PASSED:
        return STEPS
    return FEWEST_STEPS if abs(since_arrival) <= RISING else USUAL_STEPS
