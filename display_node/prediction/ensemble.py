"""Experts and their stack as one predictor, whose work is divided into short pieces.

Samples → grid → history → experts → stack → a path over the next 250 ms, interpolated by `predict`.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from display_node.prediction.analogue import Analogue
from display_node.prediction.announced import AnnouncedPath
from display_node.prediction.artefacts import ArtefactDetector
from display_node.prediction.channel_path import (
    POINTS,
    SPACING_NS,
    ChannelPath,
    between,
    bound_paths,
)
from display_node.prediction.expert import FURTHEST, HORIZONS, SPACING, Expert
from display_node.prediction.fir import Fir
from display_node.prediction.grid import STEP_NS, GridCell, Rhythm
from display_node.prediction.history import History
from display_node.prediction.path_errors import PathErrors
from display_node.prediction.r_waves import RWaveTime
from display_node.prediction.stack import Stack
from display_node.prediction.transit import TransitTime
from protocol.pieces import Pieces

CAPACITY = 8_192
# Steps in the first second, which determine the signal's level and size; until then nothing is
# predicted.
WARM_UP = 200
# Differences up to this share of a value are its rounding.
ROUNDING = 1e-12
# The error of the last beat is that of this number of beats, within these limits in steps of
# learning; while no rhythm is known, of the longer one.
JUDGED_BEATS, FEWEST_JUDGED, MOST_JUDGED = 1.25, 100, 200
# The errors to expect are computed anew after this number of steps of learning, 50 ms.
JUDGED_EVERY = 5


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
        self._paths = (self, *self.others)
        self._r_waves: list[RWaveTime] = []
        super().__init__()
        self.names = (*(name for expert in self._experts for name in expert.names), "stack")

    def begin(self) -> None:
        """Discard what was learnt, of all channels."""
        super().begin()
        for other in self.others:
            other.begin()
        self._rhythm, self._artefacts = Rhythm(), ArtefactDetector()
        channels = 1 + len(self.others)
        experts: dict[str, Expert] = {"analogue": Analogue(channels), "fir": Fir(channels)}
        chosen = experts if self._kind == "stack" else (self._kind,)
        self._experts = [experts[name] for name in chosen]
        trust = np.array([share for expert in self._experts for share in expert.trust])
        trust = trust if self._kind == "stack" else np.full(len(trust), 1 / len(trust))
        self._stack = Stack(trust, channels)
        self._errors = PathErrors(channels)
        self._history = History(CAPACITY, channels)
        # The history's count from which on the next step is one of learning, and their number.
        self._learns_from = self._learnt = 0
        # What is left of the present step.
        self._pieces = Pieces()
        # Number of the history's newest cell in the grid.
        self._number = -1
        # None until the first R wave.
        self._announced: AnnouncedPath | None = None
        # The experts' trajectories, with a view for each expert; the paths of the channels, and
        # their points within bounds.
        self._trajectories = np.zeros((len(trust), channels, HORIZONS))
        ends = np.cumsum([len(expert.names) for expert in self._experts])
        self._parts = np.split(self._trajectories, ends[:-1])
        self._ahead = np.zeros((channels, HORIZONS))
        self._points = np.zeros((channels, POINTS))
        self._heights = np.zeros(channels)
        # Of each channel: low and high of its recent values; its level and scale.
        self._ranges, self._scales = np.zeros((2, channels)), np.zeros((2, channels))

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
        if fresh and not pieces.waiting:
            pieces.begin(self._step(fresh.popleft()))
        return pieces.do_one()

    def predict_each(self, sampled_ns: int) -> list[float]:
        """Return the prediction of each of `names`, for studies."""
        if not self._path:
            return [self._newest] * len(self.names)
        before = self._path[:2]
        position = (sampled_ns - self._middle_ns) / SPACING_NS
        rows = (before[1] + self.scale * self._trajectories[:, 0]).tolist()
        return [*(between(before + row, position) for row in rows), self.predict(sampled_ns)]

    def _step(self, cell: GridCell) -> Iterator[None]:
        """Do the work for a new cell, piece by piece."""
        # All channels come with the same frames, so that their cells are the same.
        cells = [cell, *(other.grid.new_cells.popleft() for other in self.others)]
        if not self.scale:
            self._settle(cell.number, [each.value for each in cells])
            return
        history = self._history
        self._push([each.value for each in cells], cells)
        self._artefacts.observe(history)
        self._number = cell.number
        # Cells that late samples corrected replace the interpolated ones.
        for channel, path in enumerate(self._paths):
            if not path.grid.corrections:
                continue
            for late in path.grid.corrections:
                age = self._number - late.number
                history.rewrite(age, path.normalised(late.value), channel)
            path.grid.corrections.clear()
        if self._r_waves or self._announced:
            self._announce(cell)
        self._publish(cell)
        yield
        artefact = self._artefacts.present
        if history.count % SPACING == 0:
            self._errors.add(history.newest_of_each, self._ahead, self._heights, artefact)
            if self._announced:
                values = history.last(FURTHEST + 1)[::SPACING].astype(np.float64)
                self._announced.learn(values, artefact)
            if self._errors.steps % JUDGED_EVERY == 0:
                self._heights = history.heights()
                self._judge()
            history.ranges(self._ranges)
            yield
        elif self._announced:
            self._announced.prepare(history)
            yield
        for expert in self._experts:
            expert.prepare(history)
        if not cell.newest:
            # Frames of several cells determine the phase themselves.
            self._learns_from -= 1
        elif history.count >= self._learns_from:
            yield
            self._learn(artefact)

    def _learn(self, artefact: bool) -> None:
        """Learn at this step, and two or three steps later in turn.

        With a sample every 10 ms, two kinds of steps alternate, before and after the middle between
        two samples: what is learnt at one kind alone is wrong at the other.
        """
        history = self._history
        self._learns_from = history.count + SPACING + self._learnt % 2
        self._learnt += 1
        self._stack.learn(history, artefact)
        for expert in self._experts:
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
        for channel, path in enumerate(self._paths):
            path.expected = self._errors.expected(channel, path.scale, steps)

    @np.errstate(all="ignore")
    def _settle(self, number: int, values: list[float]) -> None:
        """Collect the warm-up; at its end, compute level and size and fill the history."""
        for path, value in zip(self._paths, values, strict=True):
            path.warm_up.append(value)
        if len(self.warm_up) < WARM_UP:
            return
        level, scale = _size(self.warm_up)
        if not 0 < scale < np.inf:
            for path in self._paths:
                del path.warm_up[0]
            return
        self.level, self.scale = level, scale
        for other in self.others:
            level, scale = _size(other.warm_up)
            constant = not 0 < scale < np.inf
            other.level, other.scale = (other.warm_up[-1], 1.0) if constant else (level, scale)
        for each in zip(*(path.warm_up for path in self._paths), strict=True):
            self._push(each)
        self._number = number
        self._scales[:] = [path.level for path in self._paths], [path.scale for path in self._paths]
        self._history.ranges(self._ranges)

    def _push(self, values: Sequence[float], cells: Sequence[GridCell] = ()) -> None:
        """Append a value of each channel to the history; cells: theirs, from the warm-up on."""
        history, ahead = self._history, self._history.ahead
        history.push(*[path.normalised(x) for path, x in zip(self._paths, values, strict=True)])
        for channel, cell in enumerate(cells):
            path = self._paths[channel]
            ahead[channel, 0] = path.normalised(cell.ends)
            ahead[channel, 1] = path.normalised(cell.continues)
        self._rhythm.push(history.change(SPACING))

    def _publish(self, cell: GridCell) -> None:
        """Store the stack's path in N, within bounds; start again if it is not finite."""
        history, ahead, points = self._history, self._ahead, self._points
        for expert, made in zip(self._experts, self._parts, strict=True):
            expert.predict(history, made)
        self._stack.predict(history.newest_of_each, history.ahead, self._trajectories, ahead)
        if self._announced:
            self._announced.correct(history, ahead)
        ranges, scales = self._ranges, self._scales
        if not bound_paths(history.buffer, history.end, ahead, ranges, scales, points):
            self.begin()
            return
        middle_ns = cell.end_ns - STEP_NS // 2
        for path, row in zip(self._paths, points.tolist(), strict=True):
            path.publish(row, middle_ns)


def _size(values: list[float]) -> tuple[float, float]:
    """Return mean and deviation of a warm-up; the latter is 0 where a half of it is constant.

    A pulse that has just begun after a constant would be measured by its first millisecond. The
    means of a constant over cells differ by their rounding.
    """
    for half in values[: len(values) // 2], values[len(values) // 2 :]:
        low, high = min(half), max(half)
        if high - low <= ROUNDING * max(-low, high):
            return half[-1], 0.0
    return float(np.mean(values)), float(np.std(values))
