"""Experts and their stack as one predictor, whose work is divided among ticks.

Samples → grid → history → experts → stack → a path over the next 250 ms, interpolated by `predict`.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.experts import (
    AHEAD,
    FURTHEST,
    HORIZONS,
    SPACING,
    Analogue,
    Expert,
    Fir,
    Harmonic,
)
from display_node.prediction.grid import STEP_NS, Grid, GridCell, History, Rhythm

Floats = NDArray[np.float64]
# Memory of the weights: it grows by half a step a step, so that what the experts predicted before
# they had learnt is soon forgotten.
FIRST_MEMORY_STEPS, MEMORY_STEPS = 200, 4_000
# Strength of the initial weights: at the start, and the part of it that is never forgotten.
FIRST_RIDGE, RIDGE = 10.0, 0.01
# Squared errors are limited to this in their sums, in units of the signal's variance.
WORST = 1e4
# Steps whose errors are kept: above the longest window of an estimate of the error.
ERRORS = 512
HORIZON = np.arange(HORIZONS)


class Stack:
    """Combination of n trajectories, with least-squares weights for every horizon.

    The weights are updated by recursive least squares when the predicted value arrives. trust:
    initial weights, shape (n,).
    """

    def __init__(self, trust: Floats) -> None:
        count = len(trust)
        self._trust = trust
        # For each horizon, the covariance, with the weights as a further column.
        start = np.vstack([np.eye(count) / FIRST_RIDGE, trust]).T
        self._state = np.tile(start, (HORIZONS, 1, 1))
        self._covariances, self._weights = self._state[:, :, :-1], self._state[:, :, -1]
        # Predictions of the last steps, by step and horizon: inputs, output and origin.
        self._made = np.zeros((FURTHEST + 1, HORIZONS, count + 2))
        self._steps = 0
        # Running sums of the squared errors, by step and horizon.
        self._sums = np.zeros((ERRORS, HORIZONS))
        self._truths = 0

    def mean_squares(self, steps: int) -> Floats:
        """Return the mean square error at each horizon over the last steps, fewer than `ERRORS`.

        It is infinite at horizons at which fewer values have been predicted.
        """
        newest, before = self._truths % ERRORS, (self._truths - steps) % ERRORS
        total = np.maximum(self._sums[newest] - self._sums[before], 0.0)
        return np.where(self._truths - AHEAD < steps, np.inf, total / steps)

    def predict(self, newest: float, trajectories: Floats) -> Floats:
        """Combine trajectories of shape (n, 25) from a newest value."""
        made = self._made[self._steps % len(self._made)]
        inputs, output = made[:, :-2], made[:, -2]
        inputs[:], made[:, -1] = trajectories.T, newest
        np.einsum("hi,hi->h", self._weights, inputs, out=output)
        self._steps += 1
        return np.asarray(output)

    def learn(self, newest: float) -> None:
        """Update the weights by the newest value, which was predicted earlier. Call it last."""
        made = self._made[(self._steps - 1 - AHEAD) % len(self._made), HORIZON]
        inputs, outputs, origins = made[:, :-2], made[:, -2], made[:, -1]
        truths = newest - origins
        if self._steps <= FURTHEST:
            truths[self._steps <= AHEAD] = 0.0
        errors = truths - outputs
        total = self._sums[self._truths % ERRORS]
        self._truths += 1
        np.add(total, np.fmin(errors * errors, WORST), out=self._sums[self._truths % ERRORS])
        forget = 1 - 1 / min(MEMORY_STEPS, FIRST_MEMORY_STEPS + self._steps / 2)
        spread = np.einsum("hij,hj->hi", self._covariances, inputs)
        power = forget + np.einsum("hi,hi->h", inputs, spread)
        self._correct(spread, power, truths - np.einsum("hi,hi->h", self._weights, inputs))
        self._covariances *= 1 / forget
        # One weight a step is observed as its initial value, which restores the forgotten ridge.
        expert = self._steps % len(self._trust)
        spread = self._covariances[:, :, expert].copy()
        power = 1 / (RIDGE * len(self._trust) * (1 - forget)) + spread[:, expert]
        self._correct(spread, power, self._trust[expert] - self._weights[:, expert])

    def _correct(self, spread: Floats, power: Floats, errors: Floats) -> None:
        gains = spread / power[:, np.newaxis]
        change = np.concatenate([spread, -errors[:, np.newaxis]], axis=1)
        self._state -= gains[:, :, np.newaxis] * change[:, np.newaxis, :]


CAPACITY = 8_192
# Steps in the first second, which determine the signal's level and size; until then nothing is
# predicted.
WARM_UP = 200
# The error is estimated over this number of beats within these limits in steps; over the longer one
# while no rhythm is known.
JUDGED_BEATS, FEWEST_JUDGED, MOST_JUDGED = 1.25, 200, 400
# A step's work has four pieces. One piece a millisecond leaves one in five free to catch up.
SPACING_NS = SPACING * STEP_NS
PIECE_NS = 1_000_000
# Paths are bounded by the range of the last 5 s, widened on both sides by this share of it.
RECENT, MARGIN = 1_000, 0.25


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
        self._rhythm = rhythm = Rhythm()
        experts: dict[str, Expert] = {
            "analogue": Analogue(), "fir": Fir(), "harmonic": Harmonic(rhythm)
        }  # fmt: skip
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
        self._rows: Floats | None = None
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
        if self._rows is None:
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
        self._number = cell.number
        # Cells that late samples corrected replace the interpolated ones.
        for late in self._grid.corrections:
            corrected = (late.value - self._level) / self._scale
            history.rewrite(self._number - late.number, corrected)
        self._grid.corrections.clear()
        first, *others = self._experts
        first.observe(history)
        yield
        for expert in others:
            expert.observe(history)
        self._publish(cell, np.concatenate([each.predict(history) for each in self._experts]))
        yield
        self._stack.learn(history.newest)
        self._judge()
        self._bound()
        yield
        for expert in self._experts:
            expert.learn(history)

    def _judge(self) -> None:
        interval, steps = self._rhythm.interval, MOST_JUDGED
        if interval is not None:
            steps = min(max(round(JUDGED_BEATS * interval), FEWEST_JUDGED), MOST_JUDGED)
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
        self._bound()

    def _push(self, value: float) -> None:
        self._history.push((value - self._level) / self._scale)
        before, _, newest = self._history.last(3).tolist()
        self._rhythm.push(newest - before)

    def _bound(self) -> None:
        recent = self._history.last(min(RECENT, self._history.count))
        low, high = float(np.minimum.reduce(recent)), float(np.maximum.reduce(recent))
        margin = MARGIN * (high - low)
        self._bounds = low - margin, high + margin

    def _publish(self, cell: GridCell, rows: Floats) -> None:
        """Store the stack's path in N, within bounds; start again if it is not finite."""
        newest = self._history.newest
        low, high = self._bounds
        ahead = np.minimum(np.maximum(newest + self._stack.predict(newest, rows), low), high)
        values = np.concatenate([self._history.last(SPACING + 1)[::SPACING], ahead])
        path = (self._level + self._scale * values).tolist()
        if not all(map(math.isfinite, path)):
            self._begin()
            return
        self._path, self._rows = path, rows
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
