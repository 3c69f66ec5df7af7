"""Correction of the stack's paths by what R waves announce.

The announced path is a regression among the beats after their R waves (`announced_regression.py`).
A share of its difference from the stack's path is played.
"""

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.announced_regression import AnnouncedRegression
from display_node.prediction.expert import HORIZONS, SPACING, Floats
from display_node.prediction.history import History
from display_node.prediction.transit import TransitTime

# Steps from the arrival of a pulse that divide the moments of a beat: 25 ms before it, from when on
# the pulse shows how it rises, and 250 ms after it, when it has passed.
RISES, PASSED, MOMENTS = -5.0, 50.0, 3
# The shares are learnt from every second step of learning, with a memory of 10 s of each moment.
LEARNT, FORGET = 2, 1 - 1 / 500
# Strength of shares of 0. That of times when the announced path has just been wrong needs more
# evidence, since a single beat that comes much too late or too early has enormous errors.
SHARE_RIDGE = np.array([[0.1], [3.0]])
# A share is taken in full from SURE on, and not at all below DOUBTFUL: a small one is more often an
# error of its estimate than a gain. With these, 20 ms of jitter cost nothing.
DOUBTFUL, SURE = 0.2, 0.85
# Paths made 10 to 50 ms ago are judged by the newest value, with a memory of 100 ms. Differences
# below the root of USUAL decide nothing.
RECENT, RECENT_KEPT, USUAL = np.arange(1, 6), 0.81, 0.01
# Where they are among those of the last 25 steps, for each position of the present one.
MADE = (np.arange(HORIZONS)[:, np.newaxis] - RECENT) % HORIZONS * HORIZONS + RECENT - 1
# Square of the difference, in deviations of the pulse, of which a half is played in a pause.
BEAT = 1.0


class AnnouncedShare:
    """Share of the announced path's difference from the stack's path, at each horizon.

    It is from 0 to 1: the one that would have had the least squared error. There are two at each
    moment of the beat: one for when the announced path has predicted the last 100 ms well, one for
    when it has not. Before a pulse rises, the R wave announces it; then the pulse itself shows it.

    While no pulse can arrive, a beat in the stack's path is an error: of a large difference, all is
    played. What was learnt from a regular rhythm says nothing about its first pause.
    """

    def __init__(self) -> None:
        self._shares = np.zeros((MOMENTS, 2, HORIZONS))
        # Running sums for the shares: the squared differences, and their products with the stack's
        # errors, for both kinds of times; and the same of the last 100 ms, without horizons.
        self._sums = np.zeros((MOMENTS, 2, 2, HORIZONS))
        self._recent = np.zeros(2)
        # Weights of the two shares at present.
        self._weights = np.array([1.0, 0.0])
        # Of the last 25 steps of learning: the stack's paths, the differences, the weights, and the
        # moments of the beat.
        self._paths, self._differences = np.zeros((2, HORIZONS, HORIZONS))
        self._weighted = np.zeros((HORIZONS, 2, 1))
        self._moments = [0] * HORIZONS
        self._steps = self._moment = 0

    def of(self, difference: Floats, since_arrival: float, pause: tuple[float, float]) -> Floats:
        """Return the share of a difference at each horizon.

        Parameters
        ----------
        difference
            Of the announced path from the stack's, at each horizon.
        since_arrival
            Steps since the last announced pulse should have arrived, negative before.
        pause
            Steps from the present between which no pulse can rise.
        """
        self._moment = (since_arrival > RISES) + (since_arrival > PASSED)
        share: Floats = self._weights @ self._shares[self._moment]
        first = max(-int(-pause[0] // SPACING), 1) - 1
        last = min(int(pause[1] // SPACING), HORIZONS)
        if first < last:
            squares = difference[first:last] * difference[first:last]
            squares /= squares + BEAT
            np.maximum(share[first:last], squares, out=share[first:last])
        return share

    def learn(
        self,
        values: NDArray[np.floating],
        path: Floats,
        difference: Floats,
        unprecedented: bool,
        artefact: bool,
    ) -> None:
        """Learn the shares from the last 26 values of the steps of learning, the newest last.

        path, difference: the stack's path, and the announced one's difference from it.
        """
        position = self._steps % HORIZONS
        paths, differences = self._paths[position], self._differences[position]
        self._steps += 1
        if self._steps % LEARNT == 0:
            if self._steps > HORIZONS and not artefact:
                terms = np.array([differences, values[1:] - paths])
                terms *= differences
                self._sum(self._moments[position], terms[:, np.newaxis] * self._weighted[position])
            self._judge(values[-1], MADE[position])
        paths[:], differences[:] = path, difference
        self._moments[position] = self._moment
        # From a pause longer than any before, whose gain is enormous and seldom, nothing is learnt.
        self._weighted[position, :, 0] = 0.0 if unprecedented else self._weights

    def _sum(self, moment: int, terms: Floats) -> None:
        """Add squares and products of both kinds to a moment's sums, and compute its shares."""
        sums, shares = self._sums[moment], self._shares[moment]
        sums *= FORGET
        sums += terms
        np.divide(sums[1], sums[0] + SHARE_RIDGE, out=shares)
        np.maximum(shares, 0.0, out=shares)
        np.minimum(shares, 1.0, out=shares)
        sure = (shares - DOUBTFUL) * (1 / (SURE - DOUBTFUL))
        np.maximum(sure, 0.0, out=sure)
        np.minimum(sure, 1.0, out=sure)
        shares *= sure

    def _judge(self, newest: np.floating, made: NDArray[np.intp]) -> None:
        """Weigh the two shares by how well the announced path predicted the newest values."""
        differences = self._differences.take(made)
        self._recent *= RECENT_KEPT
        self._recent += differences @ differences, differences @ (newest - self._paths.take(made))
        squares, products = self._recent.tolist()
        right = min(max((products + USUAL) / (squares + USUAL), 0.0), 1.0)
        self._weights[:] = right, 1 - right


class AnnouncedPath:
    """Correction of the stack's paths of all channels by what R waves announce.

    The first channel's shares are those of all: the others are the same pulse at other places.

    transit: transit time from R waves to the pulse.
    """

    def __init__(self, channels: int = 1) -> None:
        self.transit = TransitTime()
        self._regression = AnnouncedRegression(self.transit, channels)
        self._share = AnnouncedShare()
        self._path, self._difference = np.zeros(HORIZONS), np.zeros((channels, HORIZONS))
        self._announced = np.zeros((channels, HORIZONS))

    @np.errstate(all="ignore")
    def correct(self, history: History, ahead: Floats) -> None:
        """Correct the stack's paths, shape (channels, 25), where R waves are reliable."""
        self._path[:] = ahead[0]
        if not self._regression.predict(history, self._announced):
            self._difference[:] = 0.0
            return
        np.subtract(self._announced, ahead, out=self._difference)
        transit, now = self.transit, history.count
        since_arrival = now - transit.newest - (transit.median or 0.0)
        share = self._share.of(self._difference[0], since_arrival, transit.pause(now))
        if transit.reliable:
            ahead += share * self._difference

    @np.errstate(all="ignore")
    def learn(self, values: NDArray[np.floating], artefact: bool = False) -> None:
        """Learn the shares from the last 26 values of the steps of learning, the newest last."""
        self._share.learn(
            values, self._path, self._difference[0], self._regression.unprecedented, artefact
        )

    @np.errstate(all="ignore")
    def prepare(self, history: History) -> None:
        """Prepare the announced path of the next steps; call it at every second step."""
        self._regression.prepare(history)
