"""Path of one channel over the next 250 ms, and the errors to expect of it."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.expert import HORIZONS, SPACING, Floats
from display_node.prediction.grid import STEP_NS, Grid
from display_node.prediction.kernels import ROWS, TABLE, bounded, kernel
from display_node.prediction.path_errors import ExpectedErrors
from display_node.prediction.r_waves import RWaveTime
from display_node.prediction.transit import TransitTime

# Larger values, in units of the signal's deviation, would leave only rounding errors of the others.
LARGEST = 1e6
SPACING_NS = SPACING * STEP_NS
# Points of a path: the values one spacing ago and now, and those at the horizons.
POINTS: Final = HORIZONS + 2


@kernel(f"boolean({ROWS}, int64, {TABLE}, {TABLE}, {TABLE}, {TABLE})")
def bound_paths(
    rows: NDArray[np.float32],
    end: int,
    ahead: Floats,
    ranges: Floats,
    scales: Floats,
    points: Floats,
) -> bool:
    """Write the points of each channel's path in N; return whether all of them are finite.

    Those ahead are kept within bounds: the range of recent values, or twice the last change from
    the newest one. ranges: low and high of each channel. scales: level and scale of each.
    """
    finite = True
    for channel in range(len(rows)):
        row = points[channel]
        row[0], row[1] = rows[channel, end - 1 - SPACING], rows[channel, end - 1]
        change = 2.0 * abs(row[1] - row[0])
        least = min(ranges[0, channel], row[1] - change)
        most = max(ranges[1, channel], row[1] + change)
        for horizon in range(HORIZONS):
            row[horizon + 2] = bounded(ahead[channel, horizon], least, most)
        level, scale = scales[0, channel], scales[1, channel]
        for point in range(POINTS):
            row[point] = level + scale * row[point]
            finite &= math.isfinite(row[point])
    return finite


class ChannelPath:
    """Path of one channel that an ensemble predicts, and the errors to expect of it.

    level, scale: mean and deviation in N of the channel's warm-up, 1 where it was constant.
    expected: as in `Predictor`.
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
        self.expected: ExpectedErrors | None = None

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
        """Return the RMSE in N of predictions `horizon_ns` ahead over the last beat.

        Returns None before that many results, and for a horizon beyond the path.
        """
        # The path counts from the middle of the newest cell.
        horizon = max(round((horizon_ns / STEP_NS + 0.5) / SPACING), 1)
        if self.expected is None or horizon > HORIZONS:
            return None
        return math.sqrt(self.expected.squares_n2[horizon - 1])

    def normalised(self, value: float) -> float:
        """Return a value in deviations from the level, limited."""
        value = (value - self.level) / self.scale
        if -LARGEST < value < LARGEST:
            return value
        # A value that is no number becomes the limit, too.
        return -LARGEST if value < 0 else LARGEST

    def publish(self, path: list[float], middle_ns: int) -> None:
        """Store the points of a path in N; middle_ns: middle of the newest cell."""
        self._path, self._middle_ns = path, middle_ns


def between(path: list[float], position: float) -> float:
    """Return a path's value by cubic interpolation (Catmull and Rom).

    path: points a step apart, the second at position 0. Beyond the path, its end values are held.
    """
    # Comparisons, and no calls of `min` and `max`: this runs each tick, before its command.
    last = len(path) - 2
    if position < 0.0:
        position = 0.0
    elif position > last:
        position = last
    whole = int(position)
    if whole == last:
        whole -= 1
    u = position - whole
    before, start, end = path[whole], path[whole + 1], path[whole + 2]
    after = path[whole + 3] if whole < last - 1 else end
    bend = 2 * before - 5 * start + 4 * end - after
    return start + 0.5 * u * (end - before + u * (bend + u * (3 * (start - end) + after - before)))
