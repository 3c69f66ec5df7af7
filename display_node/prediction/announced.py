"""The path of the pulse after an R wave that announces its next beat.

The analogues of the present are the moments that lay as long after their own R wave. Among them a
ridge regression of what followed on what preceded is a linear filter for this moment of the beat,
as the regression among the most similar moments is (`experts.py`); but these analogues are the
right ones also before the pulse shows the next beat.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import sposv

from display_node.prediction.experts import AHEAD, FURTHEST, HORIZONS, SPACING, Floats, Places, Row
from display_node.prediction.grid import History
from display_node.prediction.transit import TransitTime

# Lags of the regression's inputs: fewer than among similar moments, since each beat is one
# analogue. From an analogue, steps to its value and outputs.
LOCAL = np.array([1, 2, 3, 4, 6, 8, 11, 14, 18, 24, 32, 40, 60, 100])
CONTINUATION = np.concatenate([[0], AHEAD])
# Steps back to the oldest value that is used: 40 s, and from the present to each input.
REACH = 8_000
PRESENT = REACH - LOCAL
# Number of the last analogues that are used, and the least number of them.
MOST, FEWEST = 60, 4
NEAREST, FARTHEST = FURTHEST + SPACING + 1, REACH - int(LOCAL[-1]) - 1
# Width of their kernel over their mean distance.
WIDTH = 0.5
RIDGE = 0.003 * np.eye(len(LOCAL), dtype=np.float32)
# Memory of the shares in steps of learning: 10 s.
FORGET = 1 - 1 / 1_000
# Strength of shares of 0. That of moments when the announced path has just been wrong needs more
# evidence, since a single beat that comes much too late or too early has enormous errors.
SHARE_RIDGE = np.array([[0.01], [10.0]])
# Paths made 10 to 50 ms ago are judged by the newest value, with a memory of 100 ms. Differences
# below the root of USUAL decide nothing.
RECENT, RECENT_KEPT, USUAL = np.arange(1, 6), 0.9, 0.01


class Moments(NamedTuple):
    """Inputs and outputs of the regression, by analogue, or their means.

    Outputs are those of all channels, side by side.
    """

    inputs: Row
    outputs: Row


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
        # Means of the analogues for the next two steps, and the gains; none without analogues.
        self._means: list[Moments] = []
        # Running sums for the shares: the squared differences, and their products with the stack's
        # errors, for both kinds of moments; and the same of the last 100 ms, without horizons.
        self._sums = np.zeros((2, 2, HORIZONS))
        self._recent_squares = self._recent_products = 0.0
        # Weights of the two shares at present.
        self._weights = np.array([1.0, 0.0])
        # The stack's paths, the differences and the weights of the last 25 steps of learning.
        self._paths, self._differences = np.zeros((2, HORIZONS, HORIZONS))
        self._weighted = np.zeros((HORIZONS, 2))
        self._steps = 0
        self._path, self._difference = np.zeros(HORIZONS), np.zeros((channels, HORIZONS))

    def correct(self, history: History, ahead: Floats) -> None:
        """Correct the stack's paths, shape (channels, 25), where R waves are reliable."""
        self._path[:] = ahead[0]
        if not self._means:
            self._difference[:] = 0.0
            return
        mean = self._means.pop(0)
        newest = history.rows(1)
        present = history.last(REACH + 1).take(PRESENT) - newest[0]
        made = (present - mean.inputs) @ self._gains
        made += mean.outputs
        # A present unlike all its analogues is not extrapolated beyond them.
        np.maximum(made, self._low, out=made)
        np.minimum(made, self._high, out=made)
        np.subtract(made.reshape(ahead.shape) + newest, ahead, out=self._difference)
        if self.transit.reliable:
            ahead += self._weights @ self._shares * self._difference

    def learn(self, values: NDArray[np.floating], artefact: bool = False) -> None:
        """Learn the shares from the last 26 values of the steps of learning, the newest last."""
        position = self._steps % HORIZONS
        path, difference = self._paths[position], self._differences[position]
        self._steps += 1
        if self._steps > HORIZONS and not artefact:
            terms = np.array([difference, values[1:] - path])
            terms *= difference
            self._sums *= FORGET
            self._sums += terms[:, np.newaxis] * self._weighted[position][:, np.newaxis]
            squares, products = self._sums
            np.divide(products, squares + SHARE_RIDGE, out=self._shares)
            np.maximum(self._shares, 0.0, out=self._shares)
            np.minimum(self._shares, 1.0, out=self._shares)
        self._judge(float(values[-1]), position)
        path[:], difference[:] = self._path, self._difference[0]
        self._weighted[position] = self._weights

    def _judge(self, newest: float, position: int) -> None:
        """Weigh the two shares by how well the announced path predicted the newest values."""
        made = ((position - RECENT) % HORIZONS, RECENT - 1)
        differences, errors = self._differences[made], newest - self._paths[made]
        self._recent_squares = RECENT_KEPT * self._recent_squares + float(differences @ differences)
        self._recent_products = RECENT_KEPT * self._recent_products + float(differences @ errors)
        right = (self._recent_products + USUAL) / (self._recent_squares + USUAL)
        right = min(max(right, 0.0), 1.0)
        self._weights[:] = right, 1 - right

    def prepare(self, history: History) -> None:
        """Find the analogues of the next two steps, and make the regression for them."""
        lags = self._lags(history.count)
        self._means = []
        if len(lags) < FEWEST:
            return
        inputs, outputs = _moments(history, REACH + 1 - lags)
        later = _moments(history, REACH + 2 - lags)
        self._low, self._high = np.minimum.reduce(outputs), np.maximum.reduce(outputs)
        # The kernel falls with the distance from the present.
        past = history.last(REACH + 1)
        apart = inputs - (past.take(PRESENT) - past[-1])
        distances = np.einsum("ij,ij->i", apart, apart)
        distances *= -len(distances) / (WIDTH * float(np.add.reduce(distances)) + 1e-30)
        weights = np.exp(distances - np.maximum.reduce(distances))
        weights /= np.add.reduce(weights)
        mean = Moments(weights @ inputs, weights @ outputs)
        inputs -= mean.inputs
        weighted = inputs.T * weights
        products = weighted @ (outputs - mean.outputs)
        _, self._gains, failed = sposv(weighted @ inputs + RIDGE, products)
        if not failed:
            self._means = [mean, Moments(weights @ later.inputs, weights @ later.outputs)]

    def _lags(self, count: int) -> Places:
        """Return the lags of the last moments as long after their R wave as the present is."""
        newest, lags, until = self.transit.analogues
        if not len(lags):
            return lags
        # At such a moment, the next R wave had not been found yet.
        lags = lags[until > count - newest]
        longest = min(FARTHEST, count - (REACH - FARTHEST))
        return lags[(lags >= NEAREST) & (lags < longest)][-MOST:]


def _moments(history: History, places: Places) -> Moments:
    """Return inputs and outputs at places in the history's last values."""
    rows, column = history.rows(REACH + 1), places[:, np.newaxis]
    inputs = rows[0].take(column - LOCAL)
    inputs -= rows[0].take(column)
    around = rows.take(column + CONTINUATION, axis=1)
    outputs = around[..., 1:] - around[..., :1]
    return Moments(inputs, outputs.transpose(1, 0, 2).reshape(len(places), -1))
