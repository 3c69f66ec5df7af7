"""Path of one channel over the next 250 ms, and the errors to expect of it."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import HORIZONS, SPACING, Floats
from display_node.prediction.grid import STEP_NS, Grid
from display_node.prediction.kernels import FLOATS, ROWS, TABLE, bounded, kernel
from display_node.prediction.r_waves import RWaveTime
from display_node.prediction.transit import TransitTime

# Larger values, in units of the signal's deviation, would leave only rounding errors of the others.
LARGEST = 1e6
SPACING_NS = SPACING * STEP_NS
# Points of a path: the values one spacing ago and now, and those at the horizons.
POINTS: Final = HORIZONS + 2


@kernel(f"void({ROWS}, int64, {TABLE}, {FLOATS}, {FLOATS}, {TABLE})")
def bound_paths(
    rows: NDArray[np.float32], end: int, ahead: Floats, low: Floats, high: Floats, points: Floats
) -> None:
    """Write the points of each channel's path, of which those ahead are kept within bounds.

    The bounds are low and high, or twice the last change from the newest value.
    """
    for channel in range(len(rows)):
        row = points[channel]
        row[0], row[1] = rows[channel, end - 1 - SPACING], rows[channel, end - 1]
        change = 2.0 * abs(row[1] - row[0])
        least, most = min(low[channel], row[1] - change), max(high[channel], row[1] + change)
        for horizon in range(HORIZONS):
            # A value that is no number is refused when the path is published.
            row[horizon + 2] = bounded(ahead[channel, horizon], least, most)


class ChannelPath:
    """Path of one channel that an ensemble predicts, and the errors to expect of it.

    level, scale: mean and deviation in N of the channel's warm-up, 1 where it was constant.
    squares_n2: as in `Predictor`.
    """

    def __init__(self) -> None:
        self.grid = Grid()
        self._newest_ns, self._newest = -(1 << 64), 0.0
        self.begin()

    def begin(self) -> None:
        """Discard what was learnt."""
        self.warm_up: list[float] = []
        self.level, self.scale = 0.0, 0.0
        self._middle_ns = 0
        self._path: list[float] = []
        self.squares_n2: list[float] = []

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take new samples in N, in order of time within the call."""
        if times_ns[-1] > self._newest_ns:
            self._newest_ns, self._newest = times_ns[-1], values[-1]
        self.grid.observe(times_ns, values)

    def work(self) -> bool:
        """Do nothing: the ensemble works for all channels."""
        return False

    def announce(self, waves: list[RWaveTime]) -> None:
        """Do nothing: the ensemble takes R waves for all channels."""

    @property
    def transit(self) -> TransitTime | None:
        """Transit time from R waves to the pulse; None without R waves."""
        return None

    def predict(self, sampled_ns: int) -> float:
        """Return the force in N at an instant after the newest sample."""
        path = self._path
        if not path:
            return self._newest
        return between(path, (sampled_ns - self._middle_ns) / SPACING_NS)

    def error_n(self, horizon_ns: int) -> float | None:
        """Return the RMSE in N of predictions `horizon_ns` ahead over the last beat and a quarter.

        Returns None before that many results, and for a horizon beyond the path.
        """
        # The path counts from the middle of the newest cell.
        horizon = max(round((horizon_ns / STEP_NS + 0.5) / SPACING), 1)
        if horizon > len(self.squares_n2):
            return None
        square_n2 = self.squares_n2[horizon - 1]
        return math.sqrt(square_n2) if square_n2 < math.inf else None

    def normalised(self, value: float) -> float:
        """Return a value in deviations from the level, limited."""
        # A value that is no number becomes the limit, too.
        return max(-LARGEST, min(LARGEST, (value - self.level) / self.scale))

    def publish(self, points: Floats, middle_ns: int) -> bool:
        """Store a path from its normalised points; return whether all of it is finite."""
        path = (self.level + self.scale * points).tolist()
        if not all(map(math.isfinite, path)):
            return False
        self._path, self._middle_ns = path, middle_ns
        return True


def between(path: list[float], position: float) -> float:
    """Return a path's value by cubic interpolation (Catmull and Rom).

    path: points a step apart, the second at position 0. Beyond the path, its end values are held.
    """
    last = len(path) - 2
    position = min(max(position, 0.0), last)
    whole = min(int(position), last - 1)
    u = position - whole
    before, start, end = path[whole], path[whole + 1], path[whole + 2]
    after = path[min(whole + 3, last + 1)]
    bend = 2 * before - 5 * start + 4 * end - after
    return start + 0.5 * u * (end - before + u * (bend + u * (3 * (start - end) + after - before)))
