"""Beats of a recorded wrist that was pressed, by their hold-down. Pure, in bounded memory."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import BeatShape
from display_node.scoring.beats import Beat
from display_node.scoring.depth_curve import BeatPoint
from display_node.scoring.pressed_beats import (
    SteadyAnalysis,
    beat_shape,
    judge_beat,
    measure_beat,
    steady_hold_down_n,
)
from protocol.wire.messages import Frame, channel_samples
from protocol.wire.stream import HOLD_DOWN, StreamDescription
from telepulse.sample_queue import FrameReorderer

# The last so many beats are kept; a fit to them takes a second or two.
MOST_BEATS = 300
# Samples are kept for this time, which is longer than a beat and its shape.
KEPT_NS = 6_000_000_000
Floats = NDArray[np.float64]


class PressedBeats:
    """Beats of a stream that has a hold-down; of any other stream, nothing.

    count: number of beats at a steady hold-down, of which the last `MOST_BEATS` are kept.
    """

    def __init__(self) -> None:
        self.count = 0
        self._points: deque[BeatPoint] = deque(maxlen=MOST_BEATS)
        self._shapes: deque[BeatShape] = deque(maxlen=MOST_BEATS)
        self.begin()

    def begin(self) -> None:
        """Begin a session, whose times are unrelated to those before."""
        self._analysis, self._reorderer = SteadyAnalysis(), FrameReorderer()
        # Of each frame: times, pulse and hold-down.
        self._recent: deque[tuple[Floats, Floats, Floats]] = deque()
        self._places = 0, 0

    def take(
        self, frame: Frame, description: StreamDescription, channel: int, arrived_ns: int
    ) -> float | None:
        """Take a frame; return its mean hold-down in N, None for a stream without one.

        channel: number of the played channel.
        """
        names = [each.name for each in description.channels]
        if HOLD_DOWN not in names:
            return None
        self._places = channel, names.index(HOLD_DOWN)
        for each in self._reorderer.take(frame, arrived_ns):
            self._add(each)
        _, hold_down_n = self._forces(frame)
        return float(hold_down_n.mean())

    def finish(self) -> None:
        """Take the frames that are held back."""
        for frame in self._reorderer.flush():
            self._add(frame)

    def points(self) -> list[BeatPoint]:
        """Return the kept beats in the order of their hold-down, judged by their neighbours."""
        order = sorted(range(len(self._points)), key=lambda at: self._points[at].hold_down_n)
        points, shapes = [self._points[at] for at in order], [self._shapes[at] for at in order]
        return [
            point._replace(quality=judge_beat(number, points, shapes))
            for number, point in enumerate(points)
        ]

    def _forces(self, frame: Frame) -> tuple[Floats, Floats]:
        """Return the pulse and the hold-down of a frame's samples."""
        pulse_n, cell_n = (frame.values[:, at].astype(np.float64) for at in self._places)
        return pulse_n, cell_n - pulse_n

    def _add(self, frame: Frame) -> None:
        pulse_n, hold_down_n = self._forces(frame)
        first_ns, period_ns = frame.t_first_ns, frame.period_ns
        # Sensing clocks are whole numbers of ns, which floats hold exactly for a hundred days.
        times_ns = first_ns + period_ns * np.arange(len(pulse_n), dtype=np.float64)
        self._recent.append((times_ns, pulse_n, hold_down_n))
        while self._recent[0][0][0] < first_ns - KEPT_NS:
            self._recent.popleft()
        pulse = channel_samples(frame.first_sample, first_ns, period_ns, pulse_n.tolist())
        for beat in self._analysis.observe(pulse, float(hold_down_n.mean())):
            self._measure(beat)

    def _measure(self, beat: Beat) -> None:
        """Keep a beat that is whole, at a hold-down that was steady."""
        columns = zip(*self._recent, strict=True)
        times_ns, pulse_n, held_n = (np.concatenate(column) for column in columns)
        end_ns = beat.onset_ns + beat.interval_s * 1e9
        first, last = np.searchsorted(times_ns, [beat.onset_ns, end_ns])
        shape = beat_shape(beat, times_ns, pulse_n)
        force_n = steady_hold_down_n(held_n[first:last]) if first < last else None
        if shape is None or force_n is None:
            return
        self.count += 1
        self._points.append(measure_beat(beat, times_ns, pulse_n, force_n))
        self._shapes.append(shape)
