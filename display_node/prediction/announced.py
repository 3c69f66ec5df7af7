"""Correction of the stack's paths by what R waves announce.

The announced path is a regression among the beats after their R waves (`announced_regression.py`).
A share of its difference from the stack's path is played (`announced_share.py`).
"""

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.announced_regression import AnnouncedRegression
from display_node.prediction.announced_share import AnnouncedShare
from display_node.prediction.experts import HORIZONS, Floats
from display_node.prediction.grid import History
from display_node.prediction.transit import TransitTime


class AnnouncedPath:
    """Correction of the stack's paths of all channels by what R waves announce.

    The first channel's shares are those of all: the others are the same pulse at other places.

    transit: transit time from R waves to the pulse.
    """

    def __init__(self, channels: int = 1) -> None:
        self.transit = TransitTime()
        self._regression = AnnouncedRegression(self.transit)
        self._share = AnnouncedShare()
        self._path, self._difference = np.zeros(HORIZONS), np.zeros((channels, HORIZONS))

    def correct(self, history: History, ahead: Floats) -> None:
        """Correct the stack's paths, shape (channels, 25), where R waves are reliable."""
        self._path[:] = ahead[0]
        path = self._regression.predict(history)
        if path is None:
            self._difference[:] = 0.0
            return
        np.subtract(path, ahead, out=self._difference)
        transit, now = self.transit, history.count
        since_arrival = now - transit.newest - (transit.median or 0.0)
        share = self._share.of(self._difference[0], since_arrival, transit.pause(now))
        if transit.reliable:
            ahead += share * self._difference

    def learn(self, values: NDArray[np.floating], artefact: bool = False) -> None:
        """Learn the shares from the last 26 values of the steps of learning, the newest last."""
        self._share.learn(
            values, self._path, self._difference[0], self._regression.unprecedented, artefact
        )

    def prepare(self, history: History) -> None:
        """Prepare the announced path of the next steps; call it at every second step."""
        self._regression.prepare(history)
