"""Experts and their stack as one predictor, its work cut into pieces for a real-time loop.

Samples → grid → history → experts → stack → a path over the next 250 ms, which `predict` reads
between its points. For every horizon the stack weights the experts as would have been best, by
recursive least squares on what was predicted when its truth arrives.
"""

import math
from collections.abc import Iterator
from math import ceil, isfinite

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.analogue import Analogue
from display_node.prediction.expert import (
    AHEAD,
    FURTHEST,
    HORIZONS,
    SPACING,
    STEP_NS,
    Expert,
    Grid,
    GridCell,
    History,
)
from display_node.prediction.fir import Fir
from display_node.prediction.harmonic import Harmonic, Rhythm

Floats = NDArray[np.float64]
MEMORY_STEPS = 2_000
FORGET = 1 - 1 / MEMORY_STEPS
RIDGE = 0.01
ERROR_MEMORY_STEPS = 400
HORIZON = np.arange(HORIZONS)


class Stack:
    """Combines n trajectories; starts at the weights it is given."""

    def __init__(self, trust: Floats) -> None:
        count = len(trust)
        self._trust = trust
        # By horizon: the covariance, and the weights as one more column of it.
        start = np.vstack([np.eye(count) / RIDGE, trust]).T
        self._state = np.tile(start, (HORIZONS, 1, 1))
        self._covariances, self._weights = self._state[:, :, :-1], self._state[:, :, -1]
        # What was predicted at the last steps, by step and horizon: inputs, output and origin.
        self._made = np.zeros((FURTHEST + 1, HORIZONS, count + 2))
        self._steps = 0
        self._power = np.zeros(HORIZONS)
        self._truths = 0

    def rms(self, horizon: int) -> float | None:
        """RMSE of the last predictions, 2 s or so, for a horizon from 0; None before any truth."""
        truths = self._truths - int(AHEAD[horizon])
        if truths <= 0:
            return None
        share = 1 - (1 - 1 / ERROR_MEMORY_STEPS) ** truths
        return math.sqrt(float(self._power[horizon]) / share)

    def predict(self, newest: float, trajectories: Floats) -> Floats:
        """Combine trajectories of shape (n, 25) from a newest value."""
        made = self._made[self._steps % len(self._made)]
        inputs, output = made[:, :-2], made[:, -2]
        inputs[:], made[:, -1] = trajectories.T, newest
        np.einsum("hi,hi->h", self._weights, inputs, out=output)
        self._steps += 1
        return np.asarray(output)

    def learn(self, newest: float) -> None:
        """After `predict`: the newest value is the truth of earlier predictions."""
        made = self._made[(self._steps - 1 - AHEAD) % len(self._made), HORIZON]
        inputs, outputs, origins = made[:, :-2], made[:, -2], made[:, -1]
        truths = newest - origins
        if self._steps <= FURTHEST:
            truths[self._steps <= AHEAD] = 0.0
        self._score(truths - outputs)
        spread = np.einsum("hij,hj->hi", self._covariances, inputs)
        power = FORGET + np.einsum("hi,hi->h", inputs, spread)
        self._correct(spread, power, truths - np.einsum("hi,hi->h", self._weights, inputs))
        self._covariances *= 1 / FORGET
        self._keep_ridge()

    def _keep_ridge(self) -> None:
        """Observe one weight a step, at its trust, as often as forgetting has to be made good."""
        expert = self._steps % len(self._trust)
        spread = self._covariances[:, :, expert].copy()
        power = 1 / (RIDGE * len(self._trust) * (1 - FORGET)) + spread[:, expert]
        self._correct(spread, power, self._trust[expert] - self._weights[:, expert])

    def _correct(self, spread: Floats, power: Floats, errors: Floats) -> None:
        gains = spread / power[:, np.newaxis]
        change = np.concatenate([spread, -errors[:, np.newaxis]], axis=1)
        self._state -= gains[:, :, np.newaxis] * change[:, np.newaxis, :]

    def _score(self, errors: Floats) -> None:
        self._truths += 1
        self._power += (errors * errors - self._power) / ERROR_MEMORY_STEPS


CAPACITY = 8_192
# The signal's level and size are taken from its first 2 s; nothing is predicted before.
WARM_UP = 400
# A step is four pieces, and a piece a millisecond leaves one in five to catch up.
SPACING_NS = SPACING * STEP_NS
PIECE_NS = 1_000_000
# Paths stay within what was seen in the last 5 s, and this share of its range beyond.
RECENT, MARGIN = 1_000, 0.25


class Ensemble:
    """Predicts a stream of force; holds the newest value until it has learnt to do better.

    kind: "stack" of all experts, or the name of a single one. names: of the predictions that
    are weighted, then "stack".
    """

    def __init__(self, kind: str, tick_ns: int) -> None:
        self._kind = kind
        self._pieces_a_tick = ceil(tick_ns / PIECE_NS)
        self._grid = Grid()
        self._newest_ns, self._newest = -(1 << 64), 0.0
        self._begin()
        self.names = (*(name for expert in self._experts for name in expert.names), "stack")

    def _begin(self) -> None:
        self._rhythm = Rhythm()
        self._experts = _experts(self._kind, self._rhythm)
        self._stack = Stack(np.array([e.trust for e in self._experts for _ in e.names]))
        self._history = History(CAPACITY)
        self._warm_up: list[float] = []
        self._level, self._scale = 0.0, 0.0
        self._work: Iterator[None] = iter(())
        # Cells are numbered by the grid; this one is the history's newest.
        self._number = -1
        self._middle_ns = 0
        self._rows: NDArray[np.float64] | None = None
        self._path: list[float] = []

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take new samples, in order among themselves; times on the sensing clock."""
        if times_ns[-1] > self._newest_ns:
            self._newest_ns, self._newest = times_ns[-1], values[-1]
        self._grid.observe(times_ns, values)

    def work(self) -> None:
        """Do the next piece of the work that waits, or two after a burst; once a tick."""
        with np.errstate(all="ignore"):
            # Samples that were held up come in a burst: it is caught up with in double time.
            hurry = 2 if len(self._grid.fresh) > 1 else 1
            for _ in range(hurry * self._pieces_a_tick):
                if next(self._work, self) is self and self._grid.fresh:
                    self._work = self._step(self._grid.fresh.popleft())
                    next(self._work, None)

    def predict(self, instant_ns: int) -> float:
        """Return the force in N at an instant after the newest sample."""
        path = self._path
        if not path:
            return self._newest
        return _between(path, (instant_ns - self._middle_ns) / SPACING_NS)

    def predict_each(self, instant_ns: int) -> list[float]:
        """Return what each of `names` predicts, for studies."""
        if self._rows is None:
            return [self._newest] * len(self.names)
        before = self._path[:2]
        position = (instant_ns - self._middle_ns) / SPACING_NS
        rows = (before[1] + self._scale * self._rows).tolist()
        return [*(_between(before + row, position) for row in rows), self.predict(instant_ns)]

    def error_n(self, horizon_ns: int) -> float | None:
        """Return the RMSE in N of the last 2 s of predictions so far ahead of the newest sample.

        None before any, and further ahead than is predicted.
        """
        # From the middle of the newest cell.
        horizon = round((horizon_ns / STEP_NS + 0.5) / SPACING)
        if horizon > HORIZONS:
            return None
        rms = self._stack.rms(max(horizon, 1) - 1)
        return None if rms is None else self._scale * rms

    def _step(self, cell: GridCell) -> Iterator[None]:
        """All that a new cell asks for, piece by piece."""
        if not self._scale:
            self._settle(cell)
            return
        history = self._history
        self._push(cell.value)
        self._number = cell.number
        self._mend()
        first, *others = self._experts
        first.observe(history)
        yield
        for expert in others:
            expert.observe(history)
        self._publish(cell, np.concatenate([each.predict(history) for each in self._experts]))
        yield
        self._stack.learn(history.newest)
        self._bound()
        yield
        for expert in self._experts:
            expert.learn(history)

    def _settle(self, cell: GridCell) -> None:
        """Collect the warm-up; at its end, learn its level and size and take it in."""
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
        history = self._history
        history.push((value - self._level) / self._scale)
        before, _, newest = history.last(3).tolist()
        self._rhythm.push(newest - before)

    def _mend(self) -> None:
        """Write late samples' cells over what had been guessed."""
        for cell in self._grid.late:
            mended = (cell.value - self._level) / self._scale
            self._history.rewrite(self._number - cell.number, mended)
        self._grid.late.clear()

    def _bound(self) -> None:
        """Set what paths stay within."""
        recent = self._history.last(min(RECENT, self._history.count))
        low, high = float(np.minimum.reduce(recent)), float(np.maximum.reduce(recent))
        margin = MARGIN * (high - low)
        self._bounds = low - margin, high + margin

    def _publish(self, cell: GridCell, rows: NDArray[np.float64]) -> None:
        """Make the path of the stack, in N, and its errors; begin anew if they left all bounds."""
        history, scale = self._history, self._scale
        newest = history.newest
        low, high = self._bounds
        ahead = np.minimum(np.maximum(newest + self._stack.predict(newest, rows), low), high)
        values = np.concatenate([history.last(SPACING + 1)[::SPACING], ahead])
        path = (self._level + scale * values).tolist()
        if not all(map(isfinite, path)):
            self._begin()
            return
        self._path, self._rows = path, rows
        self._middle_ns = cell.end_ns - STEP_NS // 2


def _experts(kind: str, rhythm: Rhythm) -> list[Expert]:
    match kind:
        case "fir":
            return [Fir()]
        case "analogue":
            return [Analogue()]
        case "harmonic":
            return [Harmonic(rhythm)]
        case _:
            return [Analogue(), Fir(), Harmonic(rhythm)]


def _between(path: list[float], position: float) -> float:
    """Return a path's value, by the cubic through its neighbours' slopes (Catmull and Rom).

    path: points a step apart, the second at position 0; it is held beyond its ends.
    """
    last = len(path) - 2
    position = min(max(position, 0.0), last)
    whole = min(int(position), last - 1)
    u = position - whole
    before, start, end = path[whole], path[whole + 1], path[whole + 2]
    after = path[min(whole + 3, last + 1)]
    bend = 2 * before - 5 * start + 4 * end - after
    return start + 0.5 * u * (end - before + u * (bend + u * (3 * (start - end) + after - before)))
