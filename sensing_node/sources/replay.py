"""An earlier session's frames as a source: the same samples, as far apart in time as they were."""

from collections.abc import Iterable

import numpy as np

from protocol.wire.messages import Frame
from protocol.wire.stream import StreamDescription
from sensing_node.sources import SampleBlock


class ReplaySource:
    """Gives each frame as a block when its last sample is due, counted from a start.

    Samples that the recording lacks between two frames keep their sequence numbers: displays
    count them as lost.
    """

    def __init__(self, description: StreamDescription, frames: Iterable[Frame]) -> None:
        """frames: of one session, ordered by first_sample; what one repeats is left out."""
        self.period_ns = description.period_ns
        self.channels = description.channels
        self._frames = iter(frames)
        self._next = next(self._frames, None)
        self._expected = 0 if self._next is None else self._next.first_sample
        self._shift_ns = 0

    @property
    def exhausted(self) -> bool:
        """Whether all was given."""
        return self._next is None

    def begin(self, start_ns: int) -> None:
        """Let the first sample fall due at `start_ns`."""
        if self._next is not None:
            self._shift_ns = start_ns - self._next.t_first_ns

    def due_ns(self, count: int) -> int:
        """When the next frame's last sample will be due; `count` is what the frame holds."""
        frame = self._next
        if frame is None:
            return self._shift_ns
        return frame.t_first_ns + (len(frame.values) - 1) * frame.period_ns + self._shift_ns

    def read(self, now_ns: int) -> SampleBlock | None:
        """Return the next frame's samples if they are due; None when they are not."""
        while (frame := self._next) is not None and self.due_ns(1) <= now_ns:
            self._next = next(self._frames, None)
            known = max(0, self._expected - frame.first_sample)
            values = frame.values[known:].astype(np.float64)
            if not len(values):
                continue
            missing = max(0, frame.first_sample - self._expected)
            self._expected += missing + len(values)
            t_first_ns = frame.t_first_ns + known * frame.period_ns + self._shift_ns
            return SampleBlock(t_first_ns, frame.period_ns, values, missing)
        return None
