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

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.experts import (
    AHEAD,
    FURTHEST,
    HORIZONS,
    SPACING,
    Places,
    Row,
    solve,
)
from display_node.prediction.grid import History
from display_node.prediction.transit import INTERVALS, Analogues, TransitTime

# Lags of the regression's inputs: fewer than among similar moments, since each beat is one
# analogue.
LOCAL = np.array([1, 2, 3, 4, 6, 8, 11, 14, 18, 24, 32, 40, 60, 100])
# One regression serves the next steps, and is made for the middle of them. Their number follows how
# fast the gains change: most within RISING steps of the arrival, least from PASSED steps after it.
FEWEST_STEPS, USUAL_STEPS, STEPS = 2, 4, 8
RISING, PASSED = 10.0, 60.0
# A window around each analogue contains all their values; in it, the analogue is at MIDDLE.
MIDDLE = int(LOCAL[-1])
LENGTH = MIDDLE + FURTHEST + STEPS + 1
# For each step from 0 on, where the inputs and outputs are in the window.
INPUTS = MIDDLE - LOCAL + np.arange(STEPS + 1)[:, np.newaxis]
OUTPUTS = MIDDLE + AHEAD + np.arange(STEPS + 1)[:, np.newaxis]
# Steps back to the oldest value that is used: 40 s, and from the present to each input.
REACH = 8_000
PRESENT = MIDDLE - LOCAL
# Number of the last analogues that are used, the least number of them, and the one up to which
# shorter pauses than the present one count.
MOST, FEWEST, ENOUGH = 60, 4, 8
NEAREST, FARTHEST = FURTHEST + STEPS + 1, REACH - MIDDLE
# Width of their kernel over their mean distance: until the pulse arrives, and from then on, when it
# shows which beats are like the present one.
EARLY_WIDTH, WIDTH = 1.0, 0.5
# An R-R interval's difference of 150 ms counts as a deviation of the pulse; in the distances, that
# of the last one counts as much as this number of inputs. From 10 to 100, the errors are the same.
INTERVAL_STEPS, INTERVAL_WEIGHT = 30.0, np.float32(30.0)
# Number of the inputs from the pulse, before those from the R-R intervals.
PULSE = len(LOCAL)
OUTPUT = PULSE + INTERVALS
# Strength of gains of 0: the beat before, more than 120 ms ago, has a smaller part in what follows.
STRENGTHS = np.array([0.003, 0.1, 0.01], np.float32)
RIDGE = np.diag(np.repeat(STRENGTHS, (10, PULSE - 10, INTERVALS)))


class AnnouncedRegression:
    """Regression among the moments as long after their R wave as the present is.

    unprecedented: whether the present pause is longer than any before.
    """

    def __init__(self, transit: TransitTime) -> None:
        self.unprecedented = False
        self._transit = transit
        # The paths of the next steps from inputs of 0, of all channels side by side; the number of
        # those that are left.
        self._constants: Row = np.zeros((0, 0), np.float32)
        self._left = 0
        self._newest_wave = 0.0
        # Of the R waves that are analogues: when the next ones were found, in order of size; their
        # R-R intervals; and the moments after them until the first of the next ones was found.
        self._analogues: Analogues | None = None
        self._until = np.zeros(0)
        self._scaled: Row = np.zeros((0, INTERVALS), np.float32)
        self._usual: tuple[Places, Row] = np.zeros(0, np.intp), self._scaled

    def predict(self, history: History) -> Row | None:
        """Return the path of each channel, shape (channels, 25).

        Returns None where too few beats are analogues.
        """
        if not self._left:
            return None
        constant = self._constants[len(self._constants) - self._left]
        self._left -= 1
        past = history.last(MIDDLE + 1)
        made: Row = (past.take(PRESENT) - past[-1]) @ self._gains
        made += constant
        # A present unlike all its analogues is not extrapolated beyond them.
        np.maximum(made, self._low, out=made)
        np.minimum(made, self._high, out=made)
        path = made.reshape(-1, HORIZONS)
        path += history.rows(1)
        return path

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
        since = history.count - newest_wave
        arrives = self._transit.median or 0.0
        steps = _steps(since - arrives)
        past = history.rows(REACH + 1)
        begins = REACH - MIDDLE - lags
        windows = [_windows(row, begins) for row in past]
        around = windows[0]
        # The kernel falls with the distance from the present.
        apart = around.take(INPUTS[0], axis=1)
        apart -= around[:, MIDDLE : MIDDLE + 1]
        apart -= past[0, -1 - MIDDLE :].take(PRESENT) - past[0, -1]
        distances = np.einsum("ij,ij->i", apart, apart)
        distances += INTERVAL_WEIGHT * intervals[:, 0] ** 2
        width = EARLY_WIDTH if since < arrives else WIDTH
        distances *= -len(distances) / (width * float(np.add.reduce(distances)) + 1e-30)
        weights = np.exp(distances - np.maximum.reduce(distances))
        weights /= np.add.reduce(weights)
        # Inputs, R-R intervals and the outputs of all channels side by side, in single precision.
        made_for = steps // 2
        at = MIDDLE + made_for
        columns = np.empty((len(lags), OUTPUT + HORIZONS * len(windows)), np.float32)
        columns[:, :PULSE] = around.take(INPUTS[made_for], axis=1)
        columns[:, :PULSE] -= around[:, at : at + 1]
        columns[:, PULSE:OUTPUT] = intervals
        outputs = columns[:, OUTPUT:]
        for place, window in enumerate(windows):
            begin = HORIZONS * place
            made = outputs[:, begin : begin + HORIZONS]
            np.subtract(
                window[:, at + SPACING : at + FURTHEST + 1 : SPACING],
                window[:, at : at + 1],
                out=made,
            )
        self._low, self._high = np.minimum.reduce(outputs), np.maximum.reduce(outputs)
        columns -= weights @ columns
        products = (columns[:, :OUTPUT].T * weights) @ columns
        gains, failed = solve(products[:, :OUTPUT] + RIDGE, products[:, OUTPUT:])
        if failed:
            return
        self._gains = gains[:PULSE]
        # At each of the next steps, the analogues' mean outputs less what their mean inputs add.
        # The intervals are differences from the present's, whose own input is so 0.
        means = [weights @ each for each in windows]
        later = slice(MIDDLE + 1, MIDDLE + 1 + steps)
        mean_inputs = means[0].take(INPUTS[1 : steps + 1]) - means[0][later, np.newaxis]
        constants = _beside(
            [mean.take(OUTPUTS[1 : steps + 1]) - mean[later, np.newaxis] for mean in means]
        )
        constants -= mean_inputs @ self._gains
        constants -= (weights @ intervals) @ gains[PULSE:]
        self._constants, self._left = constants, steps

    def _moments(self, count: int) -> tuple[Places, Row]:
        """Return the last moments as long after their R wave as the present is.

        They are given by their lags, and the differences of their R-R intervals from the present's.
        """
        analogues = self._transit.analogues
        if analogues is not self._analogues:
            self._analogues = analogues
            self._until = np.sort(analogues.lengths)
            self._scaled = (analogues.intervals / INTERVAL_STEPS).astype(np.float32)
            self._usual = self._chosen(analogues.lags, analogues.lags > 0, count)
        since, until = count - analogues.newest, analogues.lengths
        self.unprecedented = not len(until) or since >= self._until[-1]
        if not len(until) or since < self._until[0]:
            return self._usual
        # At such a moment, the next R wave had not been found yet. In a pause as long as few or
        # none before, they are the ends of the longest ones, after which no beat was near either.
        over = np.where(until > since, 0.0, since + STEPS + 1 - until)
        lags = analogues.lags + np.rint(over).astype(np.intp)
        return self._chosen(lags, over <= np.sort(over)[:ENOUGH][-1], count)

    def _chosen(self, lags: Places, chosen: NDArray[np.bool_], count: int) -> tuple[Places, Row]:
        """Return the last of the chosen moments whose windows lie within the history."""
        longest = min(FARTHEST, count - (REACH - FARTHEST))
        chosen &= (lags >= NEAREST) & (lags < longest)
        return lags[chosen][-MOST:], self._scaled[chosen][-MOST:]


def _steps(since_arrival: float) -> int:
    """Return the number of steps that a regression serves, from a time after the arrival."""
    if since_arrival >= PASSED:
        return STEPS
    return FEWEST_STEPS if abs(since_arrival) <= RISING else USUAL_STEPS


def _windows(row: Row, begins: Places) -> Row:
    """Return the windows that begin at these places of a row, which is contiguous."""
    # A view of all windows is many times faster here than `sliding_window_view`.
    size = row.itemsize
    every: Row = np.ndarray((len(row) - LENGTH + 1, LENGTH), np.float32, row, 0, (size, size))
    windows: Row = every[begins]
    return windows


def _beside(parts: list[Row]) -> Row:
    """Return the channels' parts side by side."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
