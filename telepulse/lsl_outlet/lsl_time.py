"""Unix time as LSL counts it: seconds of its local clock."""

import time
from collections.abc import Callable

TRIES = 9


class LslTime:
    """Maps Unix times of one run of a display; distances in time stay what they were.

    Right as far as this host's clock and the display's host's agree; exact where they are one.
    """

    def __init__(self, local_clock: Callable[[], float]) -> None:
        self._local_clock = local_clock
        self.begin()

    def begin(self) -> None:
        """Compare both clocks: when a run of the display begins."""
        self._unix_ns, self._lsl_s, _ = min(
            (self._compare() for _ in range(TRIES)), key=lambda reading: reading[2]
        )

    def at(self, unix_ns: int) -> float:
        """LSL's time of a Unix time, in s."""
        return self._lsl_s + (unix_ns - self._unix_ns) * 1e-9

    def _compare(self) -> tuple[int, float, float]:
        """One instant on both clocks, and how long it took to read them."""
        before_s = self._local_clock()
        unix_ns = time.time_ns()
        after_s = self._local_clock()
        return unix_ns, (before_s + after_s) / 2, after_s - before_s
