"""A recorded sweep as a wrist that can be pressed: its pulse follows the hold-down of a new press.

The recorded beats are sorted into levels of hold-down. A beat is played with a recorded interval;
at each sample, the shape is that of the two nearest levels at the same part of a beat, blended, and
the height that of the curve fitted to all beats.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import GOOD
from display_node.scoring.depth_curve import DepthCurve, fit_depth_curve
from protocol.errors import SourceError
from protocol.tactile import ElasticLayer
from protocol.tissue import StiffeningLaw
from protocol.wire.description import HOLD_DOWN, PULSE, StreamDescription
from protocol.wire.messages import Frame, encode_frame
from sensing_node.files.formats import open_signals
from sensing_node.press.probe import ProbeLimits
from sensing_node.sources.wrist import ProbedTissue, Wrist
from telepulse.recording.pressed_beats import SteadyBeat, find_steady_beats, judge_beats
from telepulse.recording.session import RecordedSession

Floats = NDArray[np.float64]
# Beats whose hold-down differs by less belong to one level.
LEVEL_N: Final = 0.04
# Columns of an exported table: film and load cell are a wrist's first two channels.
TABLE_COLUMNS = ("session", "sample", "t_ns", "force_0_n", "force_1_n")
BATCH: Final = 50
# Parts of a beat's shape, and the part at which its peak is put: beats of two levels are blended
# peak to peak, since a stronger press shortens the rise.
PARTS, PEAK_AT = 400, 60


class RecordedLevel(NamedTuple):
    """Beats at about one hold-down force, and their shapes."""

    force_n: float
    shapes: Sequence[list[float]]


class RecordedWrist(ProbedTissue):
    """Source of the channels "pulse" and "hold-down" of a recorded sweep, pressed anew.

    Below the least recorded hold-down the pulse fades to nothing at no force; beyond the greatest
    one it stays as there. The depth of the tissue is that of a typical wrist.

    curve: the curve fitted to the recording's beats. Raises SourceError without the two channels,
    and DepthError with too few good beats, or too few hold-down forces.
    """

    def __init__(self, session: RecordedSession, limits: ProbeLimits | None = None) -> None:
        super().__init__(session.description.period_ns, limits, StiffeningLaw())
        beats = _read_beats(session)
        self.curve: DepthCurve = fit_depth_curve([each.point for each in beats])
        good = [each for each in beats if each.point.quality >= GOOD]
        self._levels = _sort_into_levels(good)
        self._forces_n = [level.force_n for level in self._levels]
        self._heights: list[float] = self.curve.height_n.tolist()
        self._least_n = float(self.curve.force_n[0])
        self._step_n = float(self.curve.force_n[1]) - self._least_n
        self._intervals_s = [each.beat.interval_s for each in good]
        self._number = 0
        self._phase = 0.0

    def take(self, count: int) -> Floats:
        """Return the next samples in N, shape (count, 2)."""
        return np.array([self._next() for _ in range(count)]).reshape(count, 2)

    def _next(self) -> tuple[float, float]:
        force_n = self.force_n
        film_n = self._height_n(force_n) * self._shape(force_n) if force_n > 0 else 0.0
        interval_s = self._intervals_s[self._number % len(self._intervals_s)]
        self._phase += self.period_ns * 1e-9 / interval_s
        if self._phase >= 1.0:
            self._phase -= 1.0
            self._number += 1
        cell_n = force_n + film_n
        self._move(film_n, cell_n)
        return film_n, cell_n

    def _height_n(self, force_n: float) -> float:
        if force_n < self._least_n:
            return self._heights[0] * force_n / self._least_n
        place = min((force_n - self._least_n) / self._step_n, len(self._heights) - 1.001)
        at = int(place)
        low_n = self._heights[at]
        return low_n + (self._heights[at + 1] - low_n) * (place - at)

    def _shape(self, force_n: float) -> float:
        """Return the present value of the shape at a force, between 0 and about 1."""
        forces, levels = self._forces_n, self._levels
        above = bisect_right(forces, force_n)
        if above == 0 or above == len(forces):
            return self._value(levels[min(above, len(forces) - 1)])
        low_n, high_n = forces[above - 1], forces[above]
        part = (force_n - low_n) / (high_n - low_n)
        low, high = self._value(levels[above - 1]), self._value(levels[above])
        return low + (high - low) * part

    def _value(self, level: RecordedLevel) -> float:
        shape = level.shapes[self._number % len(level.shapes)]
        place = self._phase * PARTS
        at = int(place)
        return shape[at] + (shape[at + 1] - shape[at]) * (place - at)


def exported_session(path: Path) -> RecordedSession:
    """Return the pulse and hold-down of an exported table of samples as a session.

    Of several sessions, the longest is taken. Raises SourceError.
    """
    table = np.stack([column.values for column in open_signals(path).load(TABLE_COLUMNS)])
    if not np.isfinite(table).all():
        raise SourceError(f"{path}: a value of {', '.join(TABLE_COLUMNS)} is missing")
    session, sample, t_ns, film_n, cell_n = table
    numbers, counts = np.unique(session, return_counts=True)
    mine = session == numbers[counts.argmax()]
    # Copies came over other connections.
    samples, first_of = np.unique(sample[mine].astype(np.int64), return_index=True)
    times_ns = t_ns[mine][first_of]
    values = np.column_stack([film_n, cell_n])[mine][first_of].astype("<f4")
    if len(samples) < 2:
        raise SourceError(f"{path}: holds no stream of samples")
    period_ns = round(float(np.median(np.diff(times_ns) / np.diff(samples))))
    if period_ns <= 0:
        raise SourceError(f"{path}: its samples do not follow one another in time")
    description = StreamDescription(path.stem, period_ns, BATCH, Wrist.channels, ElasticLayer())
    found = RecordedSession(1, description, samples=len(samples))
    gaps = np.flatnonzero(np.diff(samples) != 1) + 1
    for begin, end in pairwise([0, *gaps.tolist(), len(samples)]):
        for at in range(begin, end, BATCH):
            part = values[at : min(at + BATCH, end)]
            frame = Frame(1, int(samples[at]), int(times_ns[at]), period_ns, part)
            found.data[frame.first_sample] = encode_frame(frame)
    return found


def _read_beats(session: RecordedSession) -> list[SteadyBeat]:
    """Return the beats of a recording in the order of hold-down. Raises SourceError."""
    names = [channel.name for channel in session.description.channels]
    if HOLD_DOWN not in names or PULSE not in names:
        raise SourceError(
            f"the recording has the channels {', '.join(names)}; to be pressed it needs"
            f" {PULSE!r} and {HOLD_DOWN!r}, as one of a pressed wrist has"
        )
    frames = list(session.frames())
    return judge_beats(find_steady_beats(frames, names.index(PULSE), names.index(HOLD_DOWN)))


def _drawn(steady: SteadyBeat) -> Floats:
    """Return a beat's shape, without the line from its begin to its end, with its peak in place."""
    beat = steady.beat
    at_ns = beat.onset_ns + np.linspace(0, beat.interval_s * 1e9, PARTS + 1)
    values: Floats = np.interp(at_ns, steady.times_ns, steady.pulse_n)
    values = (values - np.linspace(values[0], values[-1], PARTS + 1))[:PARTS]
    # Without that line, the beat's begin follows its end.
    values = np.roll(values, PEAK_AT - int(values.argmax()))
    return np.append(values, values[0]) / np.ptp(values)


def _sort_into_levels(beats: Sequence[SteadyBeat]) -> list[RecordedLevel]:
    """Return the levels of hold-down, from the least to the greatest."""
    groups: list[list[SteadyBeat]] = []
    for beat in beats:
        if not groups or beat.point.hold_down_n - groups[-1][0].point.hold_down_n > LEVEL_N:
            groups.append([])
        groups[-1].append(beat)
    return [
        RecordedLevel(
            float(np.mean([beat.point.hold_down_n for beat in group])),
            [[*_drawn(beat).tolist(), 0.0] for beat in group],
        )
        for group in groups
    ]
