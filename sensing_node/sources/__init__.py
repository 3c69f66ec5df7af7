"""Sources of pulse force, one file a kind.

A source that knows sample number i without waiting (synthetic, recording) gives samples in
order by `take`; `PacedSource` turns that into samples that fall due as time passes. A live sensor
(`live.py`) gives blocks of what has come.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from protocol.wire.stream import Channel


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples: values in N of shape (samples, channels), times on the local clock.

    missing: samples taken right before them that were lost on their way to this node.
    """

    t_first_ns: int
    period_ns: int
    values: NDArray[np.float64]
    missing: int = 0


class SampleSource(Protocol):
    """A source that gives its samples in order."""

    @property
    def period_ns(self) -> int:
        """Time between samples."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What the columns are."""

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples, shape (at most count, channels); fewer only at the end."""


class PacedSource:
    """Lets samples fall due: sample i at start_ns + i · period_ns."""

    def __init__(self, samples: SampleSource, start_ns: int) -> None:
        self._samples = samples
        self._start_ns = start_ns
        self._taken = 0
        self.exhausted = False

    def due_ns(self, count: int) -> int:
        """When `count` further samples will be due."""
        return self._start_ns + (self._taken + count - 1) * self._samples.period_ns

    def read(self, now_ns: int) -> SampleBlock | None:
        """All samples due by now that were not read yet; None when there are none."""
        period_ns = self._samples.period_ns
        count = (now_ns - self._start_ns) // period_ns + 1 - self._taken
        if count <= 0 or self.exhausted:
            return None
        values = self._samples.take(count)
        self.exhausted = len(values) < count
        if not len(values):
            return None
        block = SampleBlock(self.due_ns(1), period_ns, values)
        self._taken += len(values)
        return block
