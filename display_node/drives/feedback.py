"""A real feedback film: samples come when they come, a loop needs one a tick.

A sensor's samples arrive in batches, each some milliseconds after it was taken. Read at a
fixed age, they are as regular as the sensor took them, and the loop knows by how much they lag.
"""

import math
from collections import deque

# Enough for an age of 50 ms at 10 kHz.
KEEP = 1_000
# The loop is stable with readings of the age that it assumes: with a film 20 ms late it swung, and
# pressed a finger three times as stiff as the scene's with 3.55 N of 2.5 N. Adapters deliver every
# 16 ms, so some readings of each 100 ms are new.
LATE_NS = 5_000_000
LATE_FOR_NS = 100_000_000
LATE_READS = 20


class Feedback:
    """Gives the film's force at a fixed age. Pure: samples and the time come in.

    latency_ns: the age; stale_after_ns: from the newest sample on, this long it stands in for
    those that do not come.
    """

    def __init__(self, latency_ns: int, stale_after_ns: int) -> None:
        self._latency_ns = latency_ns
        self._stale_after_ns = stale_after_ns
        self._samples: deque[tuple[int, float]] = deque(maxlen=KEEP)
        # Since when and for how long all readings have been late, how many, and their least age.
        self._late_since_ns = self._late_for_ns = self._late_reads = self._least_age_ns = 0
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

    @property
    def late(self) -> str | None:
        """The fault of readings that have been older than assumed for 100 ms; None without."""
        if self._late_reads < LATE_READS or self._late_for_ns < LATE_FOR_NS:
            return None
        least_ms, assumed_ms = self._least_age_ns * 1e-6, self._latency_ns * 1e-6
        return (
            f"feedback late: readings are {least_ms:.0f} ms old or older, not {assumed_ms:.0f} ms"
        )

    def read(self, now_ns: int) -> float:
        """The force in N, `latency_ns` ago: between two samples on the straight line, after the
        newest that one. NaN where there is nothing to go by. Times must not go back."""
        samples, then_ns = self._samples, now_ns - self._latency_ns
        if not self.alive(now_ns):
            return math.nan
        self._judge(now_ns - samples[-1][0], now_ns)
        while len(samples) > 1 and samples[1][0] <= then_ns:
            samples.popleft()
        time_ns, force_n = samples[0]
        if then_ns <= time_ns or len(samples) == 1:
            return force_n
        next_ns, next_n = samples[1]
        return force_n + (next_n - force_n) * (then_ns - time_ns) / (next_ns - time_ns)

    def _judge(self, age_ns: int, now_ns: int) -> None:
        """Count readings that are all older than assumed; age_ns: of the newest one."""
        if age_ns <= self._latency_ns + LATE_NS:
            self._late_reads = 0
            return
        if not self._late_reads:
            self._late_since_ns, self._least_age_ns = now_ns, age_ns
        self._late_reads += 1
        self._late_for_ns = now_ns - self._late_since_ns
        self._least_age_ns = min(self._least_age_ns, age_ns)
