"""A real feedback film: samples come when they come, a loop needs one a tick.

A sensor's samples arrive in batches, each some milliseconds after it was taken. Read at a
fixed age, they are as regular as the sensor took them, and the loop knows by how much they lag.
"""

import math
from collections import deque

# Enough for an age of 50 ms at 10 kHz.
KEEP = 1_000


class Feedback:
    """Gives the film's force at a fixed age. Pure: samples and the time come in.

    latency_ns: the age; stale_after_ns: from the newest sample on, this long it stands in for
    those that do not come.
    """

    def __init__(self, latency_ns: int, stale_after_ns: int) -> None:
        self._latency_ns = latency_ns
        self._stale_after_ns = stale_after_ns
        self._samples: deque[tuple[int, float]] = deque(maxlen=KEEP)
        self.samples = 0
        self.out_of_order = 0

    def hear(self, time_ns: int, force_n: float) -> None:
        """A sample that was taken at a time; one that is not newer than the last is counted
        and left out."""
        if self._samples and time_ns <= self._samples[-1][0]:
            self.out_of_order += 1
            return
        self.samples += 1
        self._samples.append((time_ns, force_n))

    @property
    def newest(self) -> tuple[int, float] | None:
        """Time and force in N of the newest sample; None before any."""
        return self._samples[-1] if self._samples else None

    def alive(self, now_ns: int) -> bool:
        """Return whether the newest sample is recent enough for readings."""
        samples = self._samples
        return bool(samples) and now_ns - samples[-1][0] <= self._stale_after_ns

    def read(self, now_ns: int) -> float:
        """The force in N, `latency_ns` ago: between two samples on the straight line, after the
        newest that one. NaN where there is nothing to go by. Times must not go back."""
        samples, then_ns = self._samples, now_ns - self._latency_ns
        if not self.alive(now_ns):
            return math.nan
        while len(samples) > 1 and samples[1][0] <= then_ns:
            samples.popleft()
        time_ns, force_n = samples[0]
        if then_ns <= time_ns or len(samples) == 1:
            return force_n
        next_ns, next_n = samples[1]
        return force_n + (next_n - force_n) * (then_ns - time_ns) / (next_ns - time_ns)
