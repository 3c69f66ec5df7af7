"""Experts and their stack as one predictor, whose work is divided into short pieces.

Samples → grid → history → experts → stack → a path over the next 250 ms, interpolated by `predict`.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.announced import AnnouncedPath
from display_node.prediction.artefacts import ArtefactDetector
from display_node.prediction.experts import (
    FURTHEST,
    HORIZONS,
    SPACING,
    Analogue,
    Expert,
    Fir,
    Floats,
)
from display_node.prediction.grid import STEP_NS, Grid, GridCell, History, Rhythm
from display_node.prediction.r_waves import RWaveTime
from display_node.prediction.transit import TransitTime
from protocol.pieces import Pieces

# Memory of the weights, in steps of learning: it grows by half a step a step, so that what the
# experts predicted before they had learnt is soon forgotten.
FIRST_MEMORY_STEPS, MEMORY_STEPS = 30, 1_000
# Strength of the initial weights: at the start, and the part of it that is never forgotten.
FIRST_RIDGE, RIDGE = 10.0, 0.01
# Least strength, over the largest product.
LEAST_RIDGE = 1e-9
# The weights are computed anew after this number of steps, which is 50 ms.
SOLVED = 5
# Squared errors are limited to this in their sums, in units of the signal's variance.
WORST = 1e4
# Steps whose errors are kept: above the longest window of an estimate of the error.
ERRORS = 256
HORIZON = np.arange(1, HORIZONS + 1)
# Where the predictions of the present value are among those of the last 25 steps, by step and
# horizon, for each position of the newest.
ARRIVED = (HORIZON[:, np.newaxis] - 1 - HORIZON) % HORIZONS * HORIZONS + HORIZON - 1


class PathErrors:
    """Squared errors of the last paths of each channel, once their values have come."""

    def __init__(self, channels: int) -> None:
        # The paths of the last steps, and running sums of their squared errors, by step and
        # horizon.
        self._paths = np.zeros((channels, HORIZONS * HORIZONS))
        self._sums = np.zeros((channels, ERRORS, HORIZONS))
        self._steps = 0

    def add(self, newest: NDArray[np.floating], paths: Floats) -> None:
        """Judge the last paths by the newest values, shape (channels, 1), and keep new ones."""
        position = self._steps % HORIZONS
        errors = newest - self._paths.take(ARRIVED[position], axis=1)
        errors *= errors
        errors[:, self._steps :] = 0.0
        total = self._sums[:, self._steps % ERRORS]
        self._steps += 1
        np.fmin(errors, WORST, out=errors)
        np.add(total, errors, out=self._sums[:, self._steps % ERRORS])
        begin = position * HORIZONS
        self._paths[:, begin : begin + HORIZONS] = paths

    def mean_squares(self, steps: int) -> Floats:
        """Return the mean square error at each horizon over the last steps, fewer than `ERRORS`.

        It has the shape (channels, horizons), and is infinite at horizons at which fewer values
        have been predicted.
        """
        newest, before = self._steps % ERRORS, (self._steps - steps) % ERRORS
        means: Floats = np.maximum(self._sums[:, newest] - self._sums[:, before], 0.0)
        means /= steps
        # The nearest horizons were the first to be predicted.
        means[:, max(self._steps - steps, 0) :] = np.inf
        return means


class Stack:
    """Combination of n trajectories, with least-squares weights for every horizon.

    A trajectory is used when the values at all its horizons have come. trust: initial weights,
    shape (n,).
    """

    def __init__(self, trust: Floats) -> None:
        count = len(trust)
        self._trust = trust
        self._weights = np.tile(trust, (HORIZONS, 1))
        # For each horizon, the trajectories' products with each other and with the true values.
        self._products = np.zeros((HORIZONS, count, count + 1))
        self._product = np.zeros_like(self._products)
        self._ridge, self._identity = FIRST_RIDGE, np.eye(count)
        # The trajectories of the last steps with the values that they began at.
        self._made = np.zeros((HORIZONS, HORIZONS, count + 1))
        self._path = np.zeros(HORIZONS)
        self._steps = 0

    def predict(self, newest: float, trajectories: Floats) -> Floats:
        """Combine trajectories of shape (n, 25) from a newest value into a path."""
        self._trajectories, self._newest = trajectories, newest
        np.einsum("hi,ih->h", self._weights, trajectories, out=self._path)
        self._path += newest
        return self._path

    def predict_others(self, newest: NDArray[np.floating], trajectories: Floats) -> Floats:
        """Combine trajectories of other channels, shape (others, n, 25), by the same weights.

        newest: their newest values, shape (others, 1).
        """
        return np.asarray(np.einsum("hi,kih->kh", self._weights, trajectories) + newest)

    def learn(self, values: NDArray[np.floating], artefact: bool = False) -> None:
        """Learn from the last 26 values of the steps of learning, the newest last.

        artefact: whether one is present; the weights are then kept. Call it after `predict`, at the
        steps from which the experts learn.
        """
        made = self._made[self._steps % HORIZONS]
        self._steps += 1
        if self._steps > HORIZONS and not artefact:
            np.subtract(values[1:], made[:, -1], out=made[:, -1])
            forget = 1 - 1 / min(MEMORY_STEPS, FIRST_MEMORY_STEPS + self._steps / 2)
            self._products *= forget
            self._products += np.multiply(
                made[:, :-1, np.newaxis], made[:, np.newaxis], out=self._product
            )
            self._ridge = RIDGE + forget * (self._ridge - RIDGE)
            if self._steps % SOLVED == 0:
                self._solve()
        made[:, :-1], made[:, -1] = self._trajectories.T, self._newest

    def _solve(self) -> None:
        # After an enormous sample, the ridge is more than the products' rounding.
        ridge = max(self._ridge, LEAST_RIDGE * float(np.maximum.reduce(self._products, axis=None)))
        squares = self._products[:, :, :-1] + ridge * self._identity
        products = self._products[:, :, -1:] + ridge * self._trust[:, np.newaxis]
        self._weights = np.asarray(np.linalg.solve(squares, products)[:, :, 0])


CAPACITY = 8_192
# Steps in the first second, which determine the signal's level and size; until then nothing is
# predicted.
WARM_UP = 200
# Larger values, in units of the signal's deviation, would leave only rounding errors of the others.
LARGEST = 1e6
# The error is estimated over this number of beats within these limits in steps of learning; while
# no rhythm is known, over the longer one.
JUDGED_BEATS, FEWEST_JUDGED, MOST_JUDGED = 1.25, 100, 200
SPACING_NS = SPACING * STEP_NS


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

    def predict(self, instant_ns: int) -> float:
        """Return the force in N at an instant after the newest sample."""
        path = self._path
        if not path:
            return self._newest
        return _between(path, (instant_ns - self._middle_ns) / SPACING_NS)

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


class Ensemble(ChannelPath):
    """Predictor of a stream of force in N; it holds the newest value during its warm-up.

    Other channels of the stream, which are the same pulse at other places, are predicted from the
    past of the first one: by the same analogues, inputs and weights. That costs a fraction of a
    predictor of their own.

    kind: "stack" of all experts, or the name of a single one. names: of the combined trajectories,
    then "stack". others: paths of the other channels.
    """

    def __init__(self, kind: str, channels: int = 1) -> None:
        self._kind = kind
        self.others = [ChannelPath() for _ in range(channels - 1)]
        self._r_waves: list[RWaveTime] = []
        super().__init__()
        self.names = (*(name for expert in self._experts for name in expert.names), "stack")

    def begin(self) -> None:
        """Discard what was learnt, of all channels."""
        super().begin()
        for other in self.others:
            other.begin()
        self._rhythm, self._artefacts = Rhythm(), ArtefactDetector()
        experts: dict[str, Expert] = {"analogue": Analogue(), "fir": Fir()}
        chosen = experts if self._kind == "stack" else (self._kind,)
        self._experts = [experts[name] for name in chosen]
        trust = np.array([share for expert in self._experts for share in expert.trust])
        self._stack = Stack(trust if self._kind == "stack" else np.full(len(trust), 1 / len(trust)))
        channels = 1 + len(self.others)
        self._errors = PathErrors(channels)
        self._history = History(CAPACITY, channels)
        # What is left of the present step.
        self._pieces = Pieces()
        # Number of the history's newest cell in the grid.
        self._number = -1
        # None until the first R wave.
        self._announced: AnnouncedPath | None = None
        # Each expert's trajectories, a view of each expert's own, and the combined path.
        self._rows = np.zeros((len(trust), HORIZONS))
        self._other_rows = np.zeros((len(self.others), len(trust), HORIZONS))
        ends = np.cumsum([len(expert.names) for expert in self._experts])
        self._parts = np.split(self._rows, ends[:-1])
        self._other_parts = np.split(self._other_rows, ends[:-1], axis=1)
        # Each channel's path, and the last two values with the path within bounds.
        self._ahead = np.zeros((channels, HORIZONS))
        self._points = np.zeros((channels, HORIZONS + 2))

    @property
    def transit(self) -> TransitTime | None:
        """Transit time from R waves to the pulse; None without R waves."""
        return None if self._announced is None else self._announced.transit

    def announce(self, waves: list[RWaveTime]) -> None:
        """Take R waves of the heart whose pulse is predicted, which announce its beats."""
        self._r_waves += waves

    def work(self) -> bool:
        """Do one piece of the waiting work; return whether there was any."""
        pieces, fresh = self._pieces, self.grid.new_cells
        if not pieces.waiting:
            if not fresh:
                return False
            pieces.begin(self._step(fresh.popleft()))
        with np.errstate(all="ignore"):
            return pieces.do_one()

    def predict_each(self, instant_ns: int) -> list[float]:
        """Return the prediction of each of `names`, for studies."""
        if not self._path:
            return [self._newest] * len(self.names)
        before = self._path[:2]
        position = (instant_ns - self._middle_ns) / SPACING_NS
        rows = (before[1] + self.scale * self._rows).tolist()
        return [*(_between(before + row, position) for row in rows), self.predict(instant_ns)]

    def _step(self, cell: GridCell) -> Iterator[None]:
        """Do the work for a new cell, piece by piece."""
        # All channels come with the same frames, so that their cells are the same.
        beside = [other.grid.new_cells.popleft().value for other in self.others]
        if not self.scale:
            self._settle(cell, beside)
            return
        history = self._history
        self._push(cell.value, beside)
        self._artefacts.observe(history)
        self._number = cell.number
        # Cells that late samples corrected replace the interpolated ones.
        for channel, path in enumerate((self, *self.others)):
            for late in path.grid.corrections:
                age = self._number - late.number
                history.rewrite(age, path.normalised(late.value), channel)
            path.grid.corrections.clear()
        if self._r_waves or self._announced:
            self._announce(cell)
        self._publish(cell)
        yield
        if history.count % SPACING:
            for expert in self._experts:
                yield from expert.prepare(history)
            if self._announced:
                yield
                self._announced.prepare(history)
            return
        artefact = self._artefacts.present
        self._errors.add(history.rows(1), self._ahead)
        values = history.last(FURTHEST + 1)[::SPACING]
        self._stack.learn(values, artefact)
        if self._announced:
            self._announced.learn(values, artefact)
        self._judge()
        self._low, self._high = history.ranges()
        for expert in self._experts:
            yield
            expert.learn(history, artefact)

    def _announce(self, cell: GridCell) -> None:
        """Give the R waves found until a cell's end, and a pulse that has just arrived."""
        if self._announced is None:
            self._announced = AnnouncedPath(self._history.channels)
        transit, count = self._announced.transit, self._history.count
        while self._r_waves and self._r_waves[0].found_ns <= cell.end_ns:
            wave = self._r_waves.pop(0)
            transit.announce(count + (wave.at_ns - cell.end_ns) / STEP_NS, count)
        if self._rhythm.steps_ago < 1:
            transit.arrive(count - self._rhythm.steps_ago)
        transit.advance(count)

    def _judge(self) -> None:
        interval, steps = self._rhythm.interval, MOST_JUDGED
        if interval is not None:
            steps = round(JUDGED_BEATS / SPACING * interval)
            steps = min(max(steps, FEWEST_JUDGED), MOST_JUDGED)
        means = self._errors.mean_squares(steps)
        for path, squares in zip((self, *self.others), means, strict=True):
            path.squares_n2 = (path.scale**2 * squares).tolist()

    def _settle(self, cell: GridCell, beside: list[float]) -> None:
        """Collect the warm-up; at its end, compute level and size and fill the history."""
        for path, value in zip((self, *self.others), (cell.value, *beside), strict=True):
            path.warm_up.append(value)
        seen = self.warm_up
        if len(seen) < WARM_UP:
            return
        level, scale = float(np.mean(seen)), float(np.std(seen))
        if not 0 < scale < np.inf:
            for path in (self, *self.others):
                del path.warm_up[0]
            return
        self.level, self.scale = level, scale
        for other in self.others:
            level, scale = float(np.mean(other.warm_up)), float(np.std(other.warm_up))
            constant = not 0 < scale < np.inf
            other.level, other.scale = (other.warm_up[-1], 1.0) if constant else (level, scale)
        for value, *rest in zip(seen, *(other.warm_up for other in self.others), strict=True):
            self._push(value, rest)
        self._number = cell.number
        self._low, self._high = self._history.ranges()

    def _push(self, value: float, beside: list[float]) -> None:
        others = (path.normalised(x) for path, x in zip(self.others, beside, strict=True))
        self._history.push(self.normalised(value), *others)
        before, _, newest = self._history.last(3).tolist()
        self._rhythm.push(newest - before)

    def _publish(self, cell: GridCell) -> None:
        """Store the stack's path in N, within bounds; start again if it is not finite."""
        history, ahead, points = self._history, self._ahead, self._points
        for expert, part in zip(self._experts, self._parts, strict=True):
            expert.predict(history, part)
        ahead[0] = self._stack.predict(history.newest, self._rows)
        rows = history.rows(SPACING + 1)
        if self.others:
            for expert, part in zip(self._experts, self._other_parts, strict=True):
                expert.predict_others(history, part)
            ahead[1:] = self._stack.predict_others(rows[1:, -1:], self._other_rows)
        if self._announced:
            self._announced.correct(history, ahead)
        np.minimum(np.maximum(ahead, self._low), self._high, out=points[:, 2:])
        points[:, :2] = rows[:, ::SPACING]
        middle_ns = cell.end_ns - STEP_NS // 2
        channels = zip((self, *self.others), points, strict=True)
        if not all(path.publish(row, middle_ns) for path, row in channels):
            self.begin()


def _between(path: list[float], position: float) -> float:
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
