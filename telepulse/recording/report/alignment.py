"""The pulse at the wrist beside what was felt of it, block by block. Pure."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.tracking_error import TrackingError, interpolate
from protocol.wire.messages import Frame
from protocol.wire.stream import StreamDescription

# Ticks wait for the samples around their instants, as in the display.
BLOCK = PATIENCE = 2_048
MAX_FRAMES = 20_000
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class AlignedTick(NamedTuple):
    """A tick at full strength: time from the recording's beginning, the sensing clock then, the
    instant played, target and felt force."""

    t_s: float
    sensing_now_ns: int
    instant_ns: int
    target_n: float
    felt_n: float


class AlignedBlock(NamedTuple):
    """Ticks in a row: times in s, force that should be felt by what was sensed (NaN where nothing
    was), and felt."""

    t_s: Floats
    wrist_n: Floats
    felt_n: Floats


class Alignment:
    """Takes frames and ticks of one session after the other, gives blocks.

    fidelity: the display's own measure of errors. ratio: force at the finger per force at the wrist
    that it is to feel; None before the display has told.
    """

    def __init__(self) -> None:
        self.fidelity = TrackingError(0.0)
        self.ratio: float | None = None
        self.channel = 0
        self._begin()

    def _begin(self) -> None:
        self._ticks: list[AlignedTick] = []
        self._t_ns: list[Ints] = []
        self._values: list[Floats] = []

    def begin(self) -> Iterator[AlignedBlock]:
        """Another session begins; what is left of the last one."""
        yield from self.finish()
        self.ratio = None
        self._begin()

    def told(self, channel: int, ratio: float) -> None:
        """What the display plays; what came before it told is scored now."""
        if self.ratio is not None:
            return
        self.channel, self.ratio = channel, ratio
        for t_ns, values in zip(self._t_ns, self._values, strict=True):
            self.fidelity.truth(t_ns, values[:, channel] * ratio)
        for tick in self._ticks:
            self.fidelity.felt(tick.sensing_now_ns, tick.instant_ns, tick.felt_n)

    def sensed(self, frame: Frame, description: StreamDescription) -> None:
        """A frame has come."""
        at = np.arange(len(frame.values), dtype=np.int64) * frame.period_ns
        t_ns = frame.t_first_ns - description.group_delay_ns + at
        values = frame.values.astype(np.float64)
        self._t_ns.append(t_ns)
        self._values.append(values)
        if self.ratio is not None:
            self.fidelity.truth(t_ns, values[:, self.channel] * self.ratio)
        if len(self._t_ns) > MAX_FRAMES:
            del self._t_ns[: MAX_FRAMES // 2], self._values[: MAX_FRAMES // 2]

    def felt(self, tick: AlignedTick) -> Iterator[AlignedBlock]:
        """A tick was; the block that is ready by it."""
        self._ticks.append(tick)
        if self.ratio is not None:
            self.fidelity.felt(tick.sensing_now_ns, tick.instant_ns, tick.felt_n)
        if len(self._ticks) >= PATIENCE + BLOCK:
            yield from self._release(BLOCK)

    def finish(self) -> Iterator[AlignedBlock]:
        """What is left."""
        while self._ticks:
            yield from self._release(min(BLOCK, len(self._ticks)))
        self.fidelity.finish()

    def _release(self, count: int) -> Iterator[AlignedBlock]:
        ticks, self._ticks = self._ticks[:count], self._ticks[count:]
        if self.ratio is None or not self._t_ns:
            return
        t_ns, values = self._gathered()
        instant_ns = np.array([tick.instant_ns for tick in ticks], np.int64)
        wrist_n = self.ratio * interpolate(instant_ns, t_ns, values[:, self.channel])
        felt_n = np.array([tick.felt_n for tick in ticks])
        yield AlignedBlock(np.array([tick.t_s for tick in ticks]), wrist_n, felt_n)
        keep = max(0, int(np.searchsorted(t_ns, instant_ns[-1])) - 1)
        self._t_ns, self._values = [t_ns[keep:]], [values[keep:]]

    def _gathered(self) -> tuple[Ints, Floats]:
        """All samples that are kept, in order of time."""
        t_ns, values = np.concatenate(self._t_ns), np.concatenate(self._values)
        order = np.argsort(t_ns, kind="stable")
        return t_ns[order], values[order]
