"""The path of the pulse after an R wave that announces its next beat.

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
    Floats,
    Places,
    Row,
    solve,
)
from display_node.prediction.grid import History
from display_node.prediction.transit import INTERVALS, TransitTime

# Lags of the regression's inputs: fewer than among similar moments, since each beat is one
# analogue.
LOCAL = np.array([1, 2, 3, 4, 6, 8, 11, 14, 18, 24, 32, 40, 60, 100])
# One regression serves so many steps, and is made for one of them. A window around each analogue
# contains all their values; in it, the analogue itself is at MIDDLE.
STEPS, MADE_FOR, MIDDLE = 4, 2, int(LOCAL[-1])
WINDOW = np.arange(-MIDDLE, FURTHEST + STEPS + 1)
INPUTS, OUTPUTS = MIDDLE - LOCAL, MIDDLE + AHEAD
# Steps back to the oldest value that is used: 40 s, and from the present to each input.
REACH = 8_000
PRESENT = REACH - LOCAL
# Number of the last analogues that are used, the least number of them, and the one up to which
# shorter pauses than the present one count.
MOST, FEWEST, ENOUGH = 60, 4, 8
NEAREST, FARTHEST = FURTHEST + STEPS + 1, REACH - MIDDLE
# Width of their kernel over their mean distance.
WIDTH = 0.5
# An R-R interval's difference of 150 ms counts as a deviation of the pulse; in the distances, that
# of the last one counts as much as this number of inputs. From 10 to 100, the errors are the same.
INTERVAL_STEPS, INTERVAL_WEIGHT = np.float32(30.0), 30.0
# Number of the inputs from the pulse, before those from the R-R intervals.
PULSE = len(LOCAL)
RIDGE = 0.003 * np.eye(PULSE + INTERVALS, dtype=np.float32)
# The shares are learnt from every second step of learning, with a memory of 10 s.
LEARNT, FORGET = 2, 1 - 1 / 500
# Strength of shares of 0. That of moments when the announced path has just been wrong needs more
# evidence, since a single beat that comes much too late or too early has enormous errors.
SHARE_RIDGE = np.array([[0.005], [5.0]])
# A share is taken in full from SURE on, and not at all below DOUBTFUL: a small one is more often an
# error of its estimate than a gain. With these, 20 ms of jitter cost nothing.
DOUBTFUL, SURE = 0.2, 0.85
# Paths made 10 to 50 ms ago are judged by the newest value, with a memory of 100 ms. Differences
# below the root of USUAL decide nothing.
RECENT, RECENT_KEPT, USUAL = np.arange(1, 6), 0.9, 0.01
# Where they are among those of the last 25 steps, for each position of the present one.
MADE = (np.arange(HORIZONS)[:, np.newaxis] - RECENT) % HORIZONS * HORIZONS + RECENT - 1


class AnnouncedPath:
    """Correction of the stack's paths by what R waves announce.

    At each horizon, the correction is a share of the difference between the announced path and the
    stack's, from 0 to 1: the one that would have had the least squared error. There are two: one
    for moments when the announced path has predicted the last 100 ms well, one for the others. The
    first channel's are those of all: the others are the same pulse at other places.
    """

    def __init__(self, channels: int = 1) -> None:
        self.transit = TransitTime()
        self._shares = np.zeros((2, HORIZONS))
        # Analogues' mean inputs and outputs for the next steps; none without analogues. Outputs are
        # those of all channels, side by side.
        self._means: list[tuple[Row, Row]] = []
        self._newest_wave = 0.0
        self._unprecedented = False
        # Running sums for the shares: the squared differences, and their products with the stack's
        # errors, for both kinds of moments; and the same of the last 100 ms, without horizons.
        self._sums = np.zeros((2, 2, HORIZONS))
        self._recent = np.zeros(2)
        # Weights of the two shares at present, and their mean.
        self._weights, self._share = np.array([1.0, 0.0]), np.zeros(HORIZONS)
        # The stack's paths, the differences and the weights of the last 25 steps of learning.
        self._paths, self._differences = np.zeros((2, HORIZONS, HORIZONS))
        self._weighted = np.zeros((HORIZONS, 2, 1))
        self._steps = 0
        self._path, self._difference = np.zeros(HORIZONS), np.zeros((channels, HORIZONS))

    def correct(self, history: History, ahead: Floats) -> None:
        """Correct the stack's paths, shape (channels, 25), where R waves are reliable."""
        self._path[:] = ahead[0]
        if not self._means:
            self._difference[:] = 0.0
            return
        inputs, made = self._means.pop(0)
        newest = history.rows(1)
        made += (history.last(REACH + 1).take(PRESENT) - newest[0] - inputs) @ self._gains
        # A present unlike all its analogues is not extrapolated beyond them.
        np.maximum(made, self._low, out=made)
        np.minimum(made, self._high, out=made)
        np.subtract(made.reshape(ahead.shape) + newest, ahead, out=self._difference)
        if self.transit.reliable:
            ahead += self._share * self._difference

    def learn(self, values: NDArray[np.floating], artefact: bool = False) -> None:
        """Learn the shares from the last 26 values of the steps of learning, the newest last."""
        position = self._steps % HORIZONS
        path, difference = self._paths[position], self._differences[position]
        self._steps += 1
        if self._steps > HORIZONS and self._steps % LEARNT == 0 and not artefact:
            terms = np.array([difference, values[1:] - path])
            terms *= difference
            self._sums *= FORGET
            self._sums += terms[:, np.newaxis] * self._weighted[position]
            squares, products = self._sums
            np.divide(products, squares + SHARE_RIDGE, out=self._shares)
            np.maximum(self._shares, 0.0, out=self._shares)
            np.minimum(self._shares, 1.0, out=self._shares)
            sure = (self._shares - DOUBTFUL) * (1 / (SURE - DOUBTFUL))
            np.maximum(sure, 0.0, out=sure)
            np.minimum(sure, 1.0, out=sure)
            self._shares *= sure
        self._judge(values[-1], MADE[position])
        np.matmul(self._weights, self._shares, out=self._share)
        path[:], difference[:] = self._path, self._difference[0]
        # From a pause longer than any before, whose gain is enormous and seldom, nothing is learnt.
        self._weighted[position, :, 0] = 0.0 if self._unprecedented else self._weights

    def _judge(self, newest: np.floating, made: Places) -> None:
        """Weigh the two shares by how well the announced path predicted the newest values."""
        differences = self._differences.take(made)
        self._recent *= RECENT_KEPT
        self._recent += differences @ differences, differences @ (newest - self._paths.take(made))
        squares, products = self._recent.tolist()
        right = min(max((products + USUAL) / (squares + USUAL), 0.0), 1.0)
        self._weights[:] = right, 1 - right

    def prepare(self, history: History) -> None:
        """Find the analogues of the next steps, and make the regression for them, when it is due.

        It is due when that before has served, and when the newest R wave is a new one. Call it at
        every second step.
        """
        newest_wave = self.transit.newest
        if len(self._means) >= SPACING and newest_wave == self._newest_wave:
            return
        self._newest_wave = newest_wave
        self._means = []
        lags, intervals = self._moments(history.count)
        if len(lags) < FEWEST:
            return
        places, past = (REACH - lags)[:, np.newaxis], history.rows(REACH + 1)
        around = past[0].take(places + WINDOW)
        around -= around[:, MIDDLE : MIDDLE + 1]
        # The kernel falls with the distance from the present.
        apart = around.take(INPUTS, axis=1) - (past[0].take(PRESENT) - past[0, -1])
        distances = np.einsum("ij,ij->i", apart, apart)
        distances += INTERVAL_WEIGHT * intervals[:, 0] ** 2
        distances *= -len(distances) / (WIDTH * float(np.add.reduce(distances)) + 1e-30)
        weights = np.exp(distances - np.maximum.reduce(distances))
        weights /= np.add.reduce(weights)
        windows = [around]
        if history.channels > 1:
            beside = past[1:].take(places + WINDOW, axis=1)
            windows += list(beside - beside[..., MIDDLE : MIDDLE + 1])
        inputs, outputs = _moment(windows, MADE_FOR)
        self._low, self._high = np.minimum.reduce(outputs), np.maximum.reduce(outputs)
        inputs = np.concatenate([inputs, intervals], axis=1)
        weighted = (inputs - weights @ inputs).T * weights
        gains, failed = solve(weighted @ inputs + RIDGE, weighted @ outputs)
        if failed:
            return
        self._gains = gains[:PULSE]
        # The intervals are differences from the present's, which so add this to each output.
        added = -(weights @ intervals) @ gains[PULSE:]
        means = [weights @ window for window in windows]
        for step in range(1, STEPS + 1):
            inputs, outputs = _moment(means, step)
            self._means.append((inputs, outputs + added))

    def _moments(self, count: int) -> tuple[Places, Row]:
        """Return the last moments as long after their R wave as the present is.

        They are given by their lags, and the differences of their R-R intervals from the present's.
        """
        newest, lags, until, intervals = self.transit.analogues
        since = count - newest
        # At such a moment, the next R wave had not been found yet. In a pause as long as few or
        # none before, they are the ends of the longest ones, after which no beat was near either.
        over = np.where(until > since, 0.0, since + STEPS + 1 - until)
        self._unprecedented = bool(np.logical_and.reduce(over))
        chosen = over <= max(np.sort(over)[:ENOUGH].tolist(), default=0.0)
        lags = lags + np.rint(over).astype(np.intp)
        longest = min(FARTHEST, count - (REACH - FARTHEST))
        chosen &= (lags >= NEAREST) & (lags < longest)
        return lags[chosen][-MOST:], intervals[chosen][-MOST:].astype(np.float32) / INTERVAL_STEPS


def _moment(windows: list[Row], step: int) -> tuple[Row, Row]:
    """Return inputs and outputs at a later step, from the channels' windows or their means."""
    at = MIDDLE + step
    inputs = windows[0].take(INPUTS + step, axis=-1) - windows[0][..., at : at + 1]
    outputs = [
        window.take(OUTPUTS + step, axis=-1) - window[..., at : at + 1] for window in windows
    ]
    return inputs, outputs[0] if len(outputs) == 1 else np.concatenate(outputs, axis=-1)
