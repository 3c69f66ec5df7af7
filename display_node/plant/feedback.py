"""Readings of the real film under the finger, at a fixed age.

Whether a reading can be true is decided in `film_plausibility.py`. Pure: times are arguments in ns
on the monotonic clock.
"""

import math
from collections import deque

from display_node.plant.film_plausibility import FilmFault
from protocol.faults import Fault

# Samples that are kept: enough for an age of 50 ms at 10 kHz.
KEEP = 1_000
# The loop is designed for readings of a given age. With a film 20 ms late it oscillated: it pressed
# a finger three times as stiff as the scene's with 3.55 N, where the limit was 2.5 N. Adapters
# that deliver every 16 ms still give some readings in time within any 100 ms.
LATE_NS = 5_000_000
LATE_FOR_NS = 100_000_000
LATE_READS = 20


class Feedback:
    """The film's force at a fixed age.

    A sensor's samples arrive in batches, some milliseconds after they were taken. Reading them at a
    fixed age restores their even spacing; the loop is designed for that lag.

    Parameters
    ----------
    latency_ns
        Age of a reading, in ns.
    stale_after_ns
        Age in ns up to which the newest sample is used when no newer one comes.

    Attributes
    ----------
    samples
        Number of samples taken.
    out_of_order
        Number of samples that were not newer than the last, and were dropped.
    """

    def __init__(self, latency_ns: int, stale_after_ns: int) -> None:
        self._latency_ns = latency_ns
        self._stale_after_ns = stale_after_ns
        self._samples: deque[tuple[int, float]] = deque(maxlen=KEEP)
        # Late readings in a row: time of the first, duration, number, and least age.
        self._late_since_ns = self._late_for_ns = self._late_reads = self._least_age_ns = 0
        self.samples = 0
        self.out_of_order = 0

    def add(self, time_ns: int, force_n: float) -> None:
        """Add a sample in N that was taken at a time."""
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

    def silent_fault(self, now_ns: int) -> Fault | None:
        """Return the fault if no sample has come for too long, else None."""
        return None if self.alive(now_ns) else FilmFault.SILENT.at(now_ns)

    def late_fault(self, now_ns: int) -> Fault | None:
        """Return the fault if readings have been older than assumed for 100 ms, else None."""
        if self._late_reads < LATE_READS or self._late_for_ns < LATE_FOR_NS:
            return None
        least_ms, assumed_ms = self._least_age_ns * 1e-6, self._latency_ns * 1e-6
        return FilmFault.LATE.at(now_ns, least_ms=least_ms, assumed_ms=assumed_ms)

    def read(self, now_ns: int) -> float:
        """Return the force in N of `latency_ns` ago; NaN where no sample is recent enough.

        The force is interpolated linearly between two samples; after the newest sample its force is
        held. Times must not go back.
        """
        samples, then_ns = self._samples, now_ns - self._latency_ns
        if not self.alive(now_ns):
            return math.nan
        self._check_age(now_ns - samples[-1][0], now_ns)
        while len(samples) > 1 and samples[1][0] <= then_ns:
            samples.popleft()
        time_ns, force_n = samples[0]
        if then_ns <= time_ns or len(samples) == 1:
            return force_n
        next_ns, next_n = samples[1]
        return force_n + (next_n - force_n) * (then_ns - time_ns) / (next_ns - time_ns)

    def _check_age(self, newest_age_ns: int, now_ns: int) -> None:
        """Count consecutive readings that are older than assumed."""
        if newest_age_ns <= self._latency_ns + LATE_NS:
            self._late_reads = 0
            return
        if not self._late_reads:
            self._late_since_ns, self._least_age_ns = now_ns, newest_age_ns
        self._late_reads += 1
        self._late_for_ns = now_ns - self._late_since_ns
        self._least_age_ns = min(self._least_age_ns, newest_age_ns)
