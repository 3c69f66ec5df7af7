"""Time in which a display's loop was ready but the machine ran something else."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

# Unit of /proc/stat on Linux.
JIFFY_NS = 10_000_000
_PROCESSOR_FIELD = 36  # of /proc/PID/stat, counted after the name
_STEAL_FIELD = 8


@dataclass(frozen=True, slots=True)
class CoreTime:
    """A reading of two times in ns, each since the process or the host began.

    at_ns: time of the reading, on this machine's clock. waited_ns: time in which the loop's thread
    was ready, but another one ran (`schedstat`, run delay). stolen_ns: time that the hypervisor
    took from the processor of the thread.
    """

    at_ns: int
    waited_ns: int
    processor: int
    stolen_ns: int


@dataclass(frozen=True, slots=True)
class Excused:
    """Missed ticks caused by the machine: while the loop waited, and while time was stolen."""

    waited: int = 0
    stolen: int = 0

    def __add__(self, other: "Excused") -> "Excused":
        return Excused(self.waited + other.waited, self.stolen + other.stolen)

    @property
    def all(self) -> int:
        """Return the sum of both."""
        return self.waited + self.stolen


NONE_EXCUSED = Excused()


def read_core_time(pid: int, at_ns: int) -> CoreTime | None:
    """Return the time that the main thread of a process has waited for a processor.

    None if it has ended, or if this kernel does not record it.
    """
    task = Path("/proc", str(pid), "task", str(pid))
    with suppress(OSError, IndexError, ValueError):
        waited_ns = int((task / "schedstat").read_text("ascii").split()[1])
        behind_name = (task / "stat").read_text("ascii", "replace").rpartition(")")[2].split()
        processor = int(behind_name[_PROCESSOR_FIELD])
        for line in Path("/proc/stat").read_text("ascii").splitlines():
            name, *_ = fields = line.split()
            if name == f"cpu{processor}":
                stolen_ns = int(fields[_STEAL_FIELD]) * JIFFY_NS
                return CoreTime(at_ns, waited_ns, processor, stolen_ns)
    return None


def missed_ticks(
    now_ns: NDArray[np.int64], tick_ns: int, within: NDArray[np.bool_] | bool = True
) -> list[tuple[int, int, int]]:
    """Return the times of the ticks before and after missed ones, and the number missed.

    within: of each pair of neighbours, whether one process made them.
    """
    missed = np.rint(np.diff(now_ns) / tick_ns).astype(int) - 1
    places = np.flatnonzero((missed > 0) & within)
    return [(int(now_ns[at]), int(now_ns[at + 1]), int(missed[at])) for at in places]


def excuse(
    misses: Sequence[tuple[int, int, int]], readings: Sequence[CoreTime], tick_ns: int
) -> Excused:
    """Return the numbers of missed ticks that the machine caused.

    For each gap, the ticks in the thread's waiting time are excused, less its usual waiting in that
    time; of the others, the ticks in stolen time. Both are taken between the readings around the
    gap. Gaps between the same two readings share these times.

    misses: see `missed_ticks`.
    """
    spans = _spans(misses, [reading.at_ns for reading in readings])
    usual = _usual_wait(readings, spans)
    found = NONE_EXCUSED
    for begin, end, count in spans:
        first, last = readings[begin], readings[end]
        waited_ns = last.waited_ns - first.waited_ns - usual * (last.at_ns - first.at_ns)
        waited = min(count, round(max(0.0, waited_ns) / tick_ns))
        stolen_ns = last.stolen_ns - first.stolen_ns if last.processor == first.processor else 0
        stolen = min(count - waited, round(max(0, stolen_ns) / tick_ns))
        found += Excused(waited, stolen)
    return found


def _spans(
    misses: Sequence[tuple[int, int, int]], times_ns: Sequence[int]
) -> list[tuple[int, int, int]]:
    """Return the missed ticks between readings; spans do not overlap."""
    spans = list[tuple[int, int, int]]()
    for from_ns, until_ns, missed in sorted(misses):
        begin, end = bisect_right(times_ns, from_ns) - 1, bisect_left(times_ns, until_ns)
        if begin < 0 or end >= len(times_ns):
            continue  # no reading at that time
        if spans and begin < spans[-1][1]:
            before, after, count = spans[-1]
            spans[-1] = before, max(after, end), count + missed
        else:
            spans.append((begin, end, missed))
    return spans


def _usual_wait(readings: Sequence[CoreTime], spans: Sequence[tuple[int, int, int]]) -> float:
    """Return the median share of time that the thread waits where no tick is missed."""
    touched = {number for begin, end, _ in spans for number in range(begin, end)}
    shares = [
        (last.waited_ns - first.waited_ns) / (last.at_ns - first.at_ns)
        for number, (first, last) in enumerate(pairwise(readings))
        if number not in touched and last.at_ns > first.at_ns
    ]
    return median(shares) if shares else 0.0
