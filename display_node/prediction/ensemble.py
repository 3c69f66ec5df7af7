"""Experts and their stack as one predictor, whose work is divided among ticks.

Samples → grid → history → experts → stack → a path over the next 250 ms, interpolated by `predict`.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

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
        # The trajectories of the last steps with the values that they began at, and their paths.
        self._made = np.zeros((HORIZONS, HORIZONS, count + 1))
        self._paths, self._path = np.zeros((HORIZONS, HORIZONS)), np.zeros(HORIZONS)
        self._steps = 0
        # Running sums of the squared errors, by step and horizon.
        self._sums = np.zeros((ERRORS, HORIZONS))

    def mean_squares(self, steps: int) -> Floats:
        """Return the mean square error at each horizon over the last steps, fewer than `ERRORS`.

        It is infinite at horizons at which fewer values have been predicted.
        """
        newest, before = self._steps % ERRORS, (self._steps - steps) % ERRORS
        means: Floats = np.maximum(self._sums[newest] - self._sums[before], 0.0)
        means /= steps
        # The nearest horizons were the first to be predicted.
        means[max(self._steps - steps, 0) :] = np.inf
        return means

    def predict(self, newest: float, trajectories: Floats) -> Floats:
        """Combine trajectories of shape (n, 25) from a newest value into a path."""
        self._trajectories, self._newest = trajectories, newest
        np.einsum("hi,ih->h", self._weights, trajectories, out=self._path)
        self._path += newest
        return self._path

    def learn(self, values: NDArray[np.floating], artefact: bool = False) -> None:
        """Learn from the last 26 values of the steps of learning, the newest last.

        artefact: whether one is present; the weights are then kept. Call it after `predict`, at the
        steps from which the experts learn.
        """
        position = self._steps % HORIZONS
        made, path = self._made[position], self._paths[position]
        errors = values[-1] - self._paths.take(ARRIVED[position])
        errors *= errors
        errors[self._steps :] = 0.0
        total = self._sums[self._steps % ERRORS]
        self._steps += 1
        np.add(total, np.fmin(errors, WORST, out=errors), out=self._sums[self._steps % ERRORS])
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
        path[:] = self._path

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
# A step's work has three or four pieces. One piece a millisecond leaves some free to catch up.
SPACING_NS = SPACING * STEP_NS
PIECE_NS = 1_000_000


class Ensemble:
    """Predictor of a stream of force in N; it holds the newest value during its warm-up.

    kind: "stack" of all experts, or the name of a single one. tick_ns: time between two calls of
    `work`. names: of the combined trajectories, then "stack".
    """

    def __init__(self, kind: str, tick_ns: int) -> None:
        self._kind = kind
        self._pieces_a_tick = math.ceil(tick_ns / PIECE_NS)
        self._grid = Grid()
        self._newest_ns, self._newest = -(1 << 64), 0.0
        self._begin()
        self.names = (*(name for expert in self._experts for name in expert.names), "stack")

    def _begin(self) -> None:
        self._rhythm, self._artefacts = Rhythm(), ArtefactDetector()
        experts: dict[str, Expert] = {"analogue": Analogue(), "fir": Fir()}
        chosen = experts if self._kind == "stack" else (self._kind,)
        self._experts = [experts[name] for name in chosen]
        trust = np.array([share for expert in self._experts for share in expert.trust])
        self._stack = Stack(trust if self._kind == "stack" else np.full(len(trust), 1 / len(trust)))
        self._history = History(CAPACITY)
        self._warm_up: list[float] = []
        self._level, self._scale = 0.0, 0.0
        self._work: Iterator[None] = iter(())
        # Number of the history's newest cell in the grid.
        self._number = -1
        self._middle_ns = 0
        # Each expert's trajectories, a view of each expert's own, and the combined path.
        self._rows = np.zeros((len(trust), HORIZONS))
        ends = np.cumsum([len(expert.names) for expert in self._experts])
        self._parts = np.split(self._rows, ends[:-1])
        self._points = np.zeros(HORIZONS + 2)
        self._path: list[float] = []
        self.squares_n2: list[float] = []

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take new samples in N, in order of time within the call."""
        if times_ns[-1] > self._newest_ns:
            self._newest_ns, self._newest = times_ns[-1], values[-1]
        self._grid.observe(times_ns, values)

    def work(self) -> None:
        """Do one tick's share of the waiting work, or twice as much after a burst."""
        fresh = self._grid.new_cells
        with np.errstate(all="ignore"):
            # Delayed samples come in a burst, which is processed at double rate.
            hurry = 2 if len(fresh) > 1 else 1
            for _ in range(hurry * self._pieces_a_tick):
                if next(self._work, self) is self and fresh:
                    self._work = self._step(fresh.popleft())
                    next(self._work, None)

    def predict(self, instant_ns: int) -> float:
        """Return the force in N at an instant after the newest sample."""
        path = self._path
        if not path:
            return self._newest
        return _between(path, (instant_ns - self._middle_ns) / SPACING_NS)

    def predict_each(self, instant_ns: int) -> list[float]:
        """Return the prediction of each of `names`, for studies."""
        if not self._path:
            return [self._newest] * len(self.names)
        before = self._path[:2]
        position = (instant_ns - self._middle_ns) / SPACING_NS
        rows = (before[1] + self._scale * self._rows).tolist()
        return [*(_between(before + row, position) for row in rows), self.predict(instant_ns)]

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

    def _step(self, cell: GridCell) -> Iterator[None]:
        """Do the work for a new cell, piece by piece."""
        if not self._scale:
            self._settle(cell)
            return
        history = self._history
        self._push(cell.value)
        self._artefacts.observe(history)
        self._number = cell.number
        # Cells that late samples corrected replace the interpolated ones.
        for late in self._grid.corrections:
            history.rewrite(self._number - late.number, self._normalised(late.value))
        self._grid.corrections.clear()
        self._publish(cell)
        yield
        if history.count % SPACING:
            for expert in self._experts:
                yield from expert.prepare(history)
            return
        artefact = self._artefacts.present
        self._stack.learn(history.last(FURTHEST + 1)[::SPACING], artefact)
        self._judge()
        self._bounds = history.bounds()
        for expert in self._experts:
            yield
            expert.learn(history, artefact)

    def _judge(self) -> None:
        interval, steps = self._rhythm.interval, MOST_JUDGED
        if interval is not None:
            steps = round(JUDGED_BEATS / SPACING * interval)
            steps = min(max(steps, FEWEST_JUDGED), MOST_JUDGED)
        self.squares_n2 = (self._scale**2 * self._stack.mean_squares(steps)).tolist()

    def _settle(self, cell: GridCell) -> None:
        """Collect the warm-up; at its end, compute level and size and fill the history."""
        seen = self._warm_up
        seen.append(cell.value)
        if len(seen) < WARM_UP:
            return
        self._level, scale = float(np.mean(seen)), float(np.std(seen))
        if not 0 < scale < np.inf:
            del seen[0]
            return
        self._scale = scale
        for value in seen:
            self._push(value)
        self._number = cell.number
        self._bounds = self._history.bounds()

    def _normalised(self, value: float) -> float:
        # A value that is no number becomes the limit, too.
        return max(-LARGEST, min(LARGEST, (value - self._level) / self._scale))

    def _push(self, value: float) -> None:
        self._history.push(self._normalised(value))
        before, _, newest = self._history.last(3).tolist()
        self._rhythm.push(newest - before)

    def _publish(self, cell: GridCell) -> None:
        """Store the stack's path in N, within bounds; start again if it is not finite."""
        history, points = self._history, self._points
        for expert, part in zip(self._experts, self._parts, strict=True):
            expert.predict(history, part)
        low, high = self._bounds
        ahead = np.maximum(self._stack.predict(history.newest, self._rows), low)
        np.minimum(ahead, high, out=points[2:])
        points[:2] = history.last(SPACING + 1)[::SPACING]
        path = (self._level + self._scale * points).tolist()
        if not all(map(math.isfinite, path)):
            self._begin()
            return
        self._path = path
        self._middle_ns = cell.end_ns - STEP_NS // 2


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
