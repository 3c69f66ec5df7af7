"""Film and load cell on two devices, as one sensor with a channel more."""

from collections import Counter, deque
from typing import Final, Protocol

import numpy as np

from protocol.wire.stream import HOLD_DOWN, Channel
from pulse_sensors.samples import SampleBlock
from pulse_sensors.sensor import Sensor

# The film's samples wait this long for the load cell's.
PATIENCE_NS: Final = 100_000_000
# Samples of the load cell that are kept: some seconds of any.
KEPT: Final = 8_192


class SampleSensor(Protocol):
    """A live sensor, or several as one."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of a sample."""

    @property
    def period_ns(self) -> int:
        """Nominal time between samples."""

    @property
    def rejected(self) -> Counter[str]:
        """Count of data that could not be used, by cause."""

    def poll(self) -> list[SampleBlock]:
        """Return the samples since the last call. Never waits."""

    def faults(self) -> list[str]:
        """Return the faults so far, one line each."""

    def close(self) -> None:
        """Release the device."""


class JoinedSensors:
    """A film's samples, each with the load cell's force at its time.

    Both must have the same delay, as a pulse belongs to the hold-down that is measured with it.
    Samples for which no force comes count as missing, and in `rejected`.
    """

    def __init__(self, film: Sensor, cell: Sensor) -> None:
        self.channels = (*film.channels, Channel(HOLD_DOWN))
        self.period_ns = film.period_ns
        self._film, self._cell = film, cell
        self._waiting: deque[SampleBlock] = deque()
        self._times_ns: deque[int] = deque(maxlen=KEPT)
        self._forces_n: deque[float] = deque(maxlen=KEPT)
        self._missing = self._alone = 0

    def poll(self) -> list[SampleBlock]:
        """Return the film's samples for which the load cell's force has arrived."""
        for block in self._cell.poll():
            self._times_ns.extend(block.times_ns)
            self._forces_n.extend(block.force_n)
        self._waiting.extend(self._film.poll())
        joined = []
        while self._waiting:
            block = self._waiting[0]
            covered = self._times_ns and self._times_ns[0] <= block.times_ns[0]
            if covered and self._times_ns[-1] >= block.times_ns[-1]:
                forces_n = np.interp(block.times_ns, self._times_ns, self._forces_n)
                values = np.column_stack([block.values, forces_n])
                missing = block.missing + self._missing
                joined.append(block._replace(values=values, missing=missing))
                self._missing = 0
            elif self._waiting[-1].end_ns - block.end_ns < PATIENCE_NS:
                break
            else:
                self._missing += len(block.values) + block.missing
                self._alone += len(block.values)
            self._waiting.popleft()
        return joined

    @property
    def rejected(self) -> Counter[str]:
        """Count of data that could not be used, by cause."""
        alone = Counter(without_load_cell=self._alone)
        return +(self._film.rejected + self._cell.rejected + alone)

    def faults(self) -> list[str]:
        """Return the faults of both, one line each."""
        return [*self._film.faults(), *self._cell.faults()]

    def close(self) -> None:
        """Release both devices."""
        self._film.close()
        self._cell.close()
