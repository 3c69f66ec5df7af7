"""Force at the wrist and at the finger over a whole recording: errors, stretches, heart rates."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.scoring.tracking_error import JND
from protocol.wire.messages import Frame
from protocol.wire.stream import StreamDescription
from telepulse.recording.report.alignment import AlignedBlock, AlignedTick, Alignment
from telepulse.recording.report.trend import Trend

# Of ticks, for heart rates: enough points a beat, and beats enough.
THIN = 10
HEART_WINDOW_S = 6.0
# Longer holes than this have no heart rate.
MAX_HOLE_S = 0.25
# Blocks in the first stretch.
STRETCH_BLOCKS = 3
Floats = NDArray[np.float64]


class Forces:
    """Forces of a recording, from frames and ticks as an `Alignment` takes them, which it holds.

    first, worst: the first stretch at full strength, and the one around the largest error.
    heart: time in s, beats a minute at the wrist and at the finger.
    """

    def __init__(self) -> None:
        self.alignment = Alignment()
        self.error_n, self.jnd_n = Trend(), Trend()
        self.first: list[AlignedBlock] = []
        self.worst: list[AlignedBlock] = []
        self.heart: list[tuple[float, float | None, float | None]] = []
        self._before: list[AlignedBlock] = []
        self._worst_n = -1.0
        self._follow_worst = False
        self._beats: list[AlignedBlock] = []

    def begin(self) -> None:
        """Begin another session."""
        self._take(self.alignment.begin())

    def told(self, channel: int, ratio: float) -> None:
        """Set the channel that the display plays, and its force ratio."""
        self.alignment.told(channel, ratio)

    def sensed(self, frame: Frame, description: StreamDescription) -> None:
        """A frame has come."""
        self.alignment.sensed(frame, description)

    def felt(self, tick: AlignedTick) -> None:
        """A tick was."""
        self._take(self.alignment.felt(tick))

    def finish(self) -> None:
        """The recording ends."""
        self._take(self.alignment.finish())

    def _take(self, blocks: Iterator[AlignedBlock]) -> None:
        for block in blocks:
            error_n = block.felt_n - block.wrist_n
            known_n = block.wrist_n[~np.isnan(error_n)]
            if not len(known_n):
                continue
            self.error_n.add(block.t_s, error_n)
            jnd_n = JND * float(np.ptp(known_n))
            self.jnd_n.add(block.t_s, np.full(len(block.t_s), jnd_n))
            self._look_at(block, float(np.nanmax(np.abs(error_n))))
            self._listen_to(block)

    def _look_at(self, block: AlignedBlock, largest_n: float) -> None:
        """Keep the first blocks, and the one with the largest error between its neighbours."""
        if len(self.first) < STRETCH_BLOCKS:
            self.first.append(block)
        if self._follow_worst:
            self.worst.append(block)
        self._follow_worst = largest_n > self._worst_n
        if self._follow_worst:
            self._worst_n, self.worst = largest_n, [*self._before, block]
        self._before = [block]

    def _listen_to(self, block: AlignedBlock) -> None:
        """Heart rates of each window of some seconds that is in one piece."""
        self._beats.append(AlignedBlock(*(values[::THIN] for values in block)))
        t_s, wrist_n, felt_n = (np.concatenate(parts) for parts in zip(*self._beats, strict=True))
        if t_s[-1] - t_s[0] < HEART_WINDOW_S:
            return
        self._beats.clear()
        rates = [_heart_rate_per_min(t_s, force_n) for force_n in (wrist_n, felt_n)]
        self.heart.append((float(t_s.mean()), rates[0], rates[1]))


def _heart_rate_per_min(t_s: Floats, force_n: Floats) -> float | None:
    known = ~np.isnan(force_n)
    t_s, force_n = t_s[known], force_n[known]
    if len(t_s) < 2 or np.diff(t_s).max() > MAX_HOLE_S:
        return None
    even_s = np.linspace(t_s[0], t_s[-1], len(t_s))
    return heart_rate_per_min(even_s, np.interp(even_s, t_s, force_n))
