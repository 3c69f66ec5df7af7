"""Correction of the stack's paths by what R waves announce.

The announced path is a regression among the beats after their R waves (`announced_regression.py`).
A share of its difference from the stack's path is played.
"""

from typing import Final

import numpy as np

from display_node.prediction.announced_regression import AnnouncedRegression
from display_node.prediction.expert import HORIZONS, SPACING, Floats
from display_node.prediction.history import History
from display_node.prediction.kernels import CUBE, FLOATS, TABLE, bounded, kernel
from display_node.prediction.stack import LARGEST, LEAST_LEVEL
from display_node.prediction.transit import TransitTime

# Steps from the arrival of a pulse that divide the moments of a beat: 25 ms before it, from when on
# the pulse shows how it rises, and 250 ms after it, when it has passed.
RISES, PASSED, MOMENTS = -5.0, 50.0, 3
# The shares are learnt from every second step of learning, with a memory of 10 s of each moment.
LEARNT, FORGET = 2, 1 - 1 / 500
# Steps of this learning over which the level of the errors is averaged, about a beat.
LEVEL_STEPS: Final = 50
# Strength of shares of 0, in steps with differences of the level. That of times when the announced
# path has just been wrong needs more evidence, since a single beat that comes much too late or too
# early has enormous errors.
SHARE_RIDGE = np.array([1.0, 1000.0])
# A share is taken in full from SURE on, and not at all below DOUBTFUL: a small one is more often an
# error of its estimate than a gain. With these, 20 ms of jitter cost nothing.
DOUBTFUL: Final = 0.2
SURE: Final = 0.85
# Paths made 10 to 50 ms ago are judged by the newest value, with a memory of 100 ms. Differences
# below the root of USUAL decide nothing.
RECENT: Final = 5
RECENT_KEPT: Final = 0.81
USUAL: Final = 0.01
# Square of the difference, in deviations of the pulse, of which a half is played in a pause.
BEAT: Final = 1.0


@kernel(f"void({FLOATS}, {FLOATS}, {FLOATS}, {FLOATS}, {FLOATS}, {CUBE}, {TABLE})")
def learn_shares(
    path: Floats,
    difference: Floats,
    values: Floats,
    weights: Floats,
    levels: Floats,
    sums: Floats,
    shares: Floats,
) -> None:
    """Add the squares and products of a path that the last values judge, and compute the shares.

    levels: of the least squared errors at each horizon, as in the stack. sums, shares: of the
    moment at which the path was made; for each kind of times, shapes (2, 2, 25) and (2, 25).
    """
    for horizon in range(HORIZONS):
        apart, error = difference[horizon], values[horizon + 1] - path[horizon]
        least = min(error * error, (error - apart) ** 2)
        level = max(levels[horizon], LEAST_LEVEL)
        counted = apart / max(level, least / LARGEST)
        levels[horizon] = level + (min(least, LARGEST * level) - level) / LEVEL_STEPS
        for kind in range(2):
            squares, products = sums[kind]
            weighted = weights[kind] * counted
            squares[horizon] = squares[horizon] * FORGET + weighted * apart
            products[horizon] = products[horizon] * FORGET + weighted * error
            found = products[horizon] / (squares[horizon] + SHARE_RIDGE[kind])
            share = bounded(found, 0.0, 1.0)
            sure = bounded((share - DOUBTFUL) / (SURE - DOUBTFUL), 0.0, 1.0)
            shares[kind, horizon] = share * sure


@kernel(f"void({TABLE}, {TABLE}, int64, float64, {FLOATS}, {FLOATS})")
def judge_announced(
    paths: Floats, differences: Floats, place: int, newest: float, recent: Floats, weights: Floats
) -> None:
    """Weigh the two shares by how well the announced path predicted the newest values.

    place: of the present step among the last 25. recent: running sums of the squared differences
    and of their products with the stack's errors.
    """
    squares = products = 0.0
    for horizon in range(RECENT):
        made = (place - horizon - 1) % HORIZONS
        apart = differences[made, horizon]
        squares += apart * apart
        products += apart * (newest - paths[made, horizon])
    recent[0] = recent[0] * RECENT_KEPT + squares
    recent[1] = recent[1] * RECENT_KEPT + products
    right = bounded((recent[1] + USUAL) / (recent[0] + USUAL), 0.0, 1.0)
    weights[0], weights[1] = right, 1.0 - right


@kernel(f"void({FLOATS}, {TABLE}, {FLOATS}, int64, int64, {FLOATS})")
def choose_share(
    weights: Floats, shares: Floats, difference: Floats, first: int, last: int, chosen: Floats
) -> None:
    """Write the share at each horizon, of which those in between `first` and `last` are a pause."""
    for horizon in range(HORIZONS):
        share = weights[0] * shares[0, horizon] + weights[1] * shares[1, horizon]
        if first <= horizon < last:
            square = difference[horizon] * difference[horizon]
            share = max(share, square / (square + BEAT))
        chosen[horizon] = share


@kernel(f"void({TABLE}, {TABLE}, {TABLE})")
def find_differences(announced: Floats, ahead: Floats, differences: Floats) -> None:
    """Write the differences of the announced paths from the stack's, shape (channels, 25)."""
    differences[:] = announced - ahead


@kernel(f"void({FLOATS}, {TABLE}, {TABLE})")
def add_share(share: Floats, differences: Floats, ahead: Floats) -> None:
    """Add a share of the differences to the paths, shape (channels, 25)."""
    for channel in range(len(ahead)):
        for horizon in range(HORIZONS):
            ahead[channel, horizon] += share[horizon] * differences[channel, horizon]


class AnnouncedShare:
    """Share of the announced path's difference from the stack's path, at each horizon.

    It is from 0 to 1: the one that would have had the least squared error. There are two at each
    moment of the beat: one for when the announced path has predicted the last 100 ms well, one for
    when it has not. Before a pulse rises, the R wave announces it; then the pulse itself shows it.

    While no pulse can arrive, a beat in the stack's path is an error: of a large difference, all is
    played. What was learnt from a regular rhythm says nothing about its first pause.
    """

    def __init__(self) -> None:
        # Of each moment, for both kinds of times: the shares, and running sums for them, the
        # squared differences and their products with the stack's errors.
        self._shares = np.zeros((MOMENTS, 2, HORIZONS))
        self._sums = np.zeros((MOMENTS, 2, 2, HORIZONS))
        # Levels of the errors; sums as those above over the last 100 ms, without horizons.
        self._levels, self._recent = np.ones(HORIZONS), np.zeros(2)
        # Weights of the two shares at present, and the present share.
        self._weights, self._chosen = np.array([1.0, 0.0]), np.zeros(HORIZONS)
        # Of the last 25 steps of learning: the stack's paths, the differences, the weights, and the
        # moments of the beat.
        self._paths, self._differences = np.zeros((2, HORIZONS, HORIZONS))
        self._weighted = np.zeros((HORIZONS, 2))
        self._moments = [0] * HORIZONS
        self._steps = self._moment = 0

    def of(self, difference: Floats, since_arrival: float, pause: tuple[float, float]) -> Floats:
        """Return the share of a difference at each horizon, valid until the next one.

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
        first = max(-int(-pause[0] // SPACING), 1) - 1
        last = min(int(pause[1] // SPACING), HORIZONS)
        shares = self._shares[self._moment]
        choose_share(self._weights, shares, difference, first, last, self._chosen)
        return self._chosen

    def learn(
        self,
        values: Floats,
        path: Floats,
        difference: Floats,
        unprecedented: bool,
        artefact: bool,
    ) -> None:
        """Learn the shares from the last 26 values of the steps of learning, the newest last.

        path, difference: the stack's path, and the announced one's difference from it.
        """
        place = self._steps % HORIZONS
        paths, differences = self._paths, self._differences
        self._steps += 1
        if self._steps % LEARNT == 0:
            if self._steps > HORIZONS and not artefact:
                moment = self._moments[place]
                of_moment = self._levels, self._sums[moment], self._shares[moment]
                made = paths[place], differences[place]
                learn_shares(*made, values, self._weighted[place], *of_moment)
            newest = values.item(-1)
            judge_announced(paths, differences, place, newest, self._recent, self._weights)
        paths[place], differences[place] = path, difference
        self._moments[place] = self._moment
        # From a pause longer than any before, whose gain is enormous and seldom, nothing is learnt.
        self._weighted[place] = 0.0 if unprecedented else self._weights


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

    def correct(self, history: History, ahead: Floats) -> None:
        """Correct the stack's paths, shape (channels, 25), where R waves are reliable."""
        self._path[:] = ahead[0]
        if not self._regression.predict(history, self._announced):
            self._difference[:] = 0.0
            return
        find_differences(self._announced, ahead, self._difference)
        transit, now = self.transit, history.count
        since_arrival = now - transit.newest - (transit.median or 0.0)
        share = self._share.of(self._difference[0], since_arrival, transit.pause(now))
        if transit.reliable:
            add_share(share, self._difference, ahead)

    def learn(self, values: Floats, artefact: bool = False) -> None:
        """Learn the shares from the last 26 values of the steps of learning, the newest last."""
        self._share.learn(
            values, self._path, self._difference[0], self._regression.unprecedented, artefact
        )

    @np.errstate(all="ignore")
    def prepare(self, history: History) -> None:
        """Prepare the announced path of the next steps; call it at every second step."""
        self._regression.prepare(history)
