"""A live sensor as a source: its samples come when they come, and some never do."""

from collections import Counter, deque

import numpy as np

from protocol.wire.stream import Channel
from pulse_sensors.reading import Reading
from pulse_sensors.sensor import Sensor
from sensing_node.sources import PacedSource, SampleBlock, SampleSource
from sensing_node.sources.replay import ReplaySource


class LiveSource:
    """What a sensor sends, as blocks of samples that follow one another.

    Where samples are missing, the next block says how many: they keep their sequence numbers,
    so that displays count them as lost. It never ends of itself.
    """

    channels = (Channel("pulse"),)
    exhausted = False

    def __init__(self, sensor: Sensor) -> None:
        self.period_ns = sensor.period_ns
        self._sensor = sensor
        self._readings: deque[Reading] = deque()
        self._read_ns = 0

    def due_ns(self, count: int) -> int:
        """When, after the last look, `count` further samples may have been taken."""
        return self._read_ns + count * self.period_ns

    def read(self, now_ns: int) -> SampleBlock | None:
        """Return samples that have come by now, up to a gap; None when none has."""
        self._read_ns = now_ns
        self._readings.extend(self._sensor.poll())
        if not self._readings:
            return None
        first = last = self._readings.popleft()
        force_n = list(first.force_n)
        while self._readings and not self._readings[0].missing:
            last = self._readings.popleft()
            force_n += last.force_n
        period_ns = round((last.end_ns - first.first_ns) / len(force_n))
        return SampleBlock(
            first.first_ns, period_ns, np.array(force_n)[:, np.newaxis], first.missing
        )

    @property
    def rejected(self) -> Counter[str]:
        """What the sensor sent that could not be used, by cause."""
        return self._sensor.rejected

    def faults(self) -> list[str]:
        """Return the faults of the sensor, one line each."""
        return self._sensor.faults()


Source = SampleSource | LiveSource | ReplaySource


def feed_of(source: Source, start_ns: int) -> PacedSource | LiveSource | ReplaySource:
    """Return the source's blocks; those of a source that knows its samples ahead are paced."""
    if isinstance(source, ReplaySource):
        source.begin(start_ns)
    return (
        source if isinstance(source, LiveSource | ReplaySource) else PacedSource(source, start_ns)
    )
