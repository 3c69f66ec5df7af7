"""From a source to frames: blocks of samples as they fall due, numbered and cut into batches.

A source whose samples are known in advance has `take`; `PacedFeed` releases them when due.
`LiveFeed` and `ReplayFeed` yield blocks of a live sensor and of a recorded session.
"""

from collections import Counter, deque
from collections.abc import Iterable

import numpy as np

from protocol.faults import Fault, Note, Part
from protocol.summary.fields import Limits
from protocol.wire.description import StreamDescription
from protocol.wire.messages import Frame
from pulse_sensors.sample_plausibility import SampleCheck
from pulse_sensors.samples import SampleBlock
from sensing_node.press.live_probe import LiveProbe, SampleSensor
from sensing_node.press.set_points import PressedProbe
from sensing_node.sources.source import SampleSource


class PacedFeed:
    """Feed of a source's samples: sample i is due at start_ns + i · period_ns."""

    def __init__(self, samples: SampleSource, start_ns: int) -> None:
        self._samples = samples
        self._start_ns = start_ns
        self._taken = 0
        self.exhausted = False

    def due_ns(self, count: int) -> int:
        """Return the time at which `count` further samples will be due."""
        return self._start_ns + (self._taken + count - 1) * self._samples.period_ns

    def read(self, now_ns: int) -> SampleBlock | None:
        """Return all samples that are due and were not read yet; None without any."""
        count = (now_ns - self._start_ns) // self._samples.period_ns + 1 - self._taken
        if count <= 0 or self.exhausted:
            return None
        values = self._samples.take(count)
        self.exhausted = len(values) < count
        if not len(values):
            return None
        first_ns = self.due_ns(1)
        self._taken += len(values)
        return SampleBlock(values, 0, first_ns, self.due_ns(1))


class LiveFeed:
    """Feed of a live sensor's samples as they arrive; it never ends by itself.

    A gap begins a new block. The `missing` samples keep their sequence numbers, so that displays
    count them as lost. pressed: the probe that takes set-points, if the sensor is under one.
    """

    exhausted = False
    group_delay_ns = 0

    def __init__(
        self, sensor: SampleSensor | LiveProbe, pressed: PressedProbe | None = None
    ) -> None:
        self.pressed = pressed
        self.channels, self.period_ns = sensor.channels, sensor.period_ns
        self._sensor = sensor
        self._blocks: deque[SampleBlock] = deque()
        self._read_ns = 0

    def due_ns(self, count: int) -> int:
        """Return the time at which `count` samples may have been taken since the last read."""
        return self._read_ns + count * self.period_ns

    def read(self, now_ns: int) -> SampleBlock | None:
        """Return the samples that have arrived, up to a gap; None without any."""
        self._read_ns = now_ns
        self._blocks.extend(self._sensor.poll())
        if not self._blocks:
            return None
        joined = [self._blocks.popleft()]
        while self._blocks and not self._blocks[0].missing:
            joined.append(self._blocks.popleft())
        values = np.concatenate([block.values for block in joined])
        return joined[0]._replace(values=values, end_ns=joined[-1].end_ns)

    @property
    def rejected(self) -> Counter[str]:
        """Count of the sensor's data that could not be used, by cause."""
        return self._sensor.rejected

    def notes(self) -> list[str]:
        """Return the faults of the sensor, which latch nothing, one line each."""
        return self._sensor.faults()

    def limits(self) -> Limits:
        """Return no limits: a sensor's electronics count none."""
        return Limits()


class ReplayFeed:
    """Feed of an earlier session's frames: the same samples at the same intervals.

    Samples that the recording lacks between two frames keep their sequence numbers, so that
    displays count them as lost.

    Parameters
    ----------
    frames : iterable of Frame
        Frames of one session, ordered by first_sample; repeated samples are left out.
    """

    pressed: PressedProbe | None = None
    group_delay_ns = 0

    def __init__(self, description: StreamDescription, frames: Iterable[Frame]) -> None:
        self.period_ns = description.period_ns
        self.channels = description.channels
        self._frames = iter(frames)
        self._next = next(self._frames, None)
        self._expected = 0 if self._next is None else self._next.first_sample
        self._shift_ns = 0

    @property
    def exhausted(self) -> bool:
        """True when all frames were read."""
        return self._next is None

    @property
    def rejected(self) -> Counter[str]:
        """Return no causes: a recording has no data that could not be used."""
        return Counter()

    def notes(self) -> list[str]:
        """Return no notes: those of the recorded session are in its recording."""
        return []

    def limits(self) -> Limits:
        """Return no limits: those of the recorded session are in its recording."""
        return Limits()

    def begin(self, start_ns: int) -> None:
        """Shift all times so that the first sample is due at `start_ns`."""
        if self._next is not None:
            self._shift_ns = start_ns - self._next.t_first_ns

    def due_ns(self, count: int) -> int:
        """Return the time at which the next frame's last sample is due; `count` is ignored."""
        frame = self._next
        if frame is None:
            return self._shift_ns
        return frame.t_first_ns + (len(frame.values) - 1) * frame.period_ns + self._shift_ns

    def read(self, now_ns: int) -> SampleBlock | None:
        """Return the next frame's samples if they are due, else None."""
        while (frame := self._next) is not None and self.due_ns(1) <= now_ns:
            self._next = next(self._frames, None)
            known = max(0, self._expected - frame.first_sample)
            values = frame.values[known:].astype(np.float64)
            if not len(values):
                continue
            missing = max(0, frame.first_sample - self._expected)
            self._expected += missing + len(values)
            first_ns = frame.t_first_ns + known * frame.period_ns + self._shift_ns
            end_ns = first_ns + len(values) * frame.period_ns
            return SampleBlock(values, missing, first_ns, end_ns)
        return None


SourceOrFeed = SampleSource | LiveFeed | ReplayFeed
"""Origin of a session's samples: a source whose samples are known in advance, or a feed already."""


def probe_faults(source: SourceOrFeed) -> list[Fault]:
    """Return the latched faults of the probe that presses a source, if one does."""
    return [] if source.pressed is None else list(source.pressed.probe.faults)


def sensor_notes(source: SourceOrFeed, check: SampleCheck) -> list[Note]:
    """Return what is doubtful in a source's samples, and latches nothing."""
    return [Note(Part.SENSOR, text) for text in (*source.notes(), *check.faults())]


def feed_of(source: SourceOrFeed, start_ns: int) -> PacedFeed | LiveFeed | ReplayFeed:
    """Return the feed itself, or that of a source; only a live feed does not begin at `start_ns`.

    A session calls it, since the time of the first sample is known only then.
    """
    if isinstance(source, ReplayFeed):
        source.begin(start_ns)
    if isinstance(source, LiveFeed | ReplayFeed):
        return source
    return PacedFeed(source, start_ns)


class Framer:
    """Numbering of one session's samples, and division into frames of at most `batch` samples.

    next_sample: sequence number of the next sample: that of all samples so far, lost ones included.
    """

    def __init__(self, description: StreamDescription, session: int) -> None:
        self._session = session
        self._batch = description.batch
        self._dtype = np.dtype(f"<f{description.bytes_per_sample}")
        self.next_sample = 0

    def frames(self, block: SampleBlock) -> list[Frame]:
        """Return the block's samples as frames, in order."""
        self.next_sample += block.missing
        values, period_ns = block.values.astype(self._dtype), block.period_ns
        frames = []
        for start in range(0, len(values), self._batch):
            part = values[start : start + self._batch]
            first_ns = block.first_ns + start * period_ns
            frames.append(Frame(self._session, self.next_sample, first_ns, period_ns, part))
            self.next_sample += len(part)
        return frames
