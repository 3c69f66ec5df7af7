"""Ticks that a display missed because of its own core time, not the machine's load."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import pairwise

from benchmarks.timing import thread_times_s
from soak.core_time import CoreTime, excuse, missed_ticks, read_core_time
from tests.support.felt_force import FeltForce
from tests.support.waiting import polled

READ_EVERY_S = 0.01


def pin(pid: int, processor: int) -> None:
    """Bind all threads of a process, present and future, to one processor."""
    for thread in os.listdir(f"/proc/{pid}/task"):
        with suppress(ProcessLookupError):
            os.sched_setaffinity(int(thread), {processor})


class OwnTime:
    """Waiting time of a process's loop thread for a processor, read every 10 ms.

    While a thread of the process itself ran on that processor (ZeroMQ's, which receives a flood),
    the loop waited for its own process: this is not excused.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._readings: list[tuple[CoreTime, int]] = []

    def read(self) -> None:
        """Read once, after a pause."""
        time.sleep(READ_EVERY_S)
        reading = read_core_time(self._pid, time.perf_counter_ns())
        if reading is not None:
            beside_s = thread_times_s(self._pid)[1]
            self._readings.append((reading, round(beside_s * 1e9)))

    def own_misses(self, felt: FeltForce, tick_ns: int) -> tuple[int, int]:
        """Return the number of missed ticks in the traces, and of those that the process caused."""
        gaps = missed_ticks(felt.trace().now_ns, tick_ns)
        count = sum(each for *_, each in gaps)
        return count, count - excuse(gaps, self._foreign(), tick_ns).all

    def _foreign(self) -> list[CoreTime]:
        """Return the readings with the loop's waiting for other processes only."""
        waited_ns, readings = 0, [replace(self._readings[0][0], waited_ns=0)]
        for (before, beside_ns), (after, beside_after_ns) in pairwise(self._readings):
            ran_ns = beside_after_ns - beside_ns
            waited_ns += max(0, after.waited_ns - before.waited_ns - ran_ns)
            readings.append(replace(after, waited_ns=waited_ns))
        return readings


@contextmanager
def own_time_of(pid: int) -> Iterator[OwnTime]:
    """Read the time of a process."""
    own = OwnTime(pid)
    with polled(own.read):
        yield own
