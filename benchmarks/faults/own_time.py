"""Ticks that a display missed because of its own core time, not the machine's load."""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from soak.core_time import CoreTime, excuse, read_core_time
from tests.support.felt_force import FeltForce

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
        self._over = threading.Event()

    def read(self) -> None:
        """Read until `finish`."""
        while not self._over.wait(READ_EVERY_S):
            reading = read_core_time(self._pid, time.perf_counter_ns())
            if reading is not None:
                self._readings.append((reading, _beside_ns(self._pid)))

    def finish(self) -> None:
        """End `read`."""
        self._over.set()

    def own_misses(self, felt: FeltForce, tick_ns: int) -> tuple[int, int]:
        """Return the number of missed ticks in the traces, and of those that the process caused."""
        now_ns = felt.trace().now_ns
        missed = np.rint(np.diff(now_ns) / tick_ns).astype(int) - 1
        gaps = [
            (int(now_ns[at]), int(now_ns[at + 1]), int(missed[at]))
            for at in np.flatnonzero(missed > 0)
        ]
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


def _beside_ns(pid: int) -> int:
    """Return the processor time in ns of all threads except the loop's."""
    total_ns = 0
    for thread in os.listdir(f"/proc/{pid}/task"):
        if int(thread) != pid:
            with suppress(OSError):
                text = Path(f"/proc/{pid}/task/{thread}/schedstat").read_text("ascii")
                total_ns += int(text.split()[0])
    return total_ns


@contextmanager
def own_time_of(pid: int) -> Iterator[OwnTime]:
    """Read the time of a process."""
    own = OwnTime(pid)
    reader = threading.Thread(target=own.read)
    reader.start()
    try:
        yield own
    finally:
        own.finish()
        reader.join()
