"""Record of a display's ticks, from its traces."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from protocol.wire.telemetry import Trace

# Ticks further apart belong to two blocks.
GAP_NS = 50_000_000


@dataclass(frozen=True, slots=True)
class Stretch:
    """The force felt in an interval.

    low_n, high_n: least and greatest felt force in N; None if no tick has one. full, less: numbers
    of ticks at full strength, and of the others.
    """

    low_n: float | None
    high_n: float | None
    full: int
    less: int


@dataclass(slots=True)
class TickRecord:
    """The ticks of one display, in blocks of at most a trace; times on this machine's clock in ns.

    ticks, full: numbers of ticks, and of those at full strength. interruptions: begin and end of
    each time without full strength within one process, and its number of ticks. misses: times of
    the ticks before and after, and the number missed. gaps: start and end of each time of more than
    50 ms without a tick, and whether the next tick was at full strength. last_ns, last_n,
    last_full: the newest tick.
    """

    tick_ns: int
    ticks: int = 0
    full: int = 0
    last_ns: int | None = None
    last_n: float = float("nan")
    last_full: bool = False
    interruptions: list[tuple[int, int, int]] = field(default_factory=list)
    misses: list[tuple[int, int, int]] = field(default_factory=list)
    gaps: list[tuple[int, int, bool]] = field(default_factory=list)
    _first_ns: list[int] = field(default_factory=list)
    _last_ns: list[int] = field(default_factory=list)
    _blocks: list[Stretch] = field(default_factory=list)
    _full_ns: int | None = None
    _less: int = 0

    def begin_process(self) -> None:
        """Expect the ticks of another process: the time between the two is no interruption."""
        self.last_ns, self._full_ns, self.last_full, self._less = None, None, False, 0

    def add(self, trace: Trace) -> None:
        """Add the ticks of a trace."""
        for at_ns, full in zip(trace.now_ns.tolist(), trace.scored.tolist(), strict=True):
            self._tick(at_ns, full)
        self.last_n = float(trace.felt_n[-1])
        self.ticks += len(trace.now_ns)
        self.full += int(np.count_nonzero(trace.scored))
        # Between two ticks of one trace a process may have been stopped.
        ends = np.flatnonzero(np.diff(trace.now_ns) > GAP_NS) + 1
        for part in (slice(a, b) for a, b in pairwise([0, *ends.tolist(), len(trace.now_ns)])):
            felt_n, full = trace.felt_n[part], int(np.count_nonzero(trace.scored[part]))
            known_n = felt_n[np.isfinite(felt_n)]
            low_n = float(known_n.min()) if len(known_n) else None
            high_n = float(known_n.max()) if len(known_n) else None
            self._first_ns.append(int(trace.now_ns[part][0]))
            self._last_ns.append(int(trace.now_ns[part][-1]))
            self._blocks.append(Stretch(low_n, high_n, full, len(felt_n) - full))

    def _tick(self, at_ns: int, full: bool) -> None:
        if self.last_ns is not None:
            missed = round((at_ns - self.last_ns) / self.tick_ns) - 1
            if missed > 0:
                self.misses.append((self.last_ns, at_ns, missed))
            if at_ns - self.last_ns > GAP_NS:
                self.gaps.append((self.last_ns, at_ns, full))
        if full:
            if self._full_ns is not None and not self.last_full:
                self.interruptions.append((self._full_ns, at_ns, self._less))
            self._full_ns, self._less = at_ns, 0
        else:
            self._less += 1
        self.last_ns, self.last_full = at_ns, full

    def between(self, from_ns: int, until_ns: int) -> Stretch:
        """Return the force felt in an interval, by whole blocks of some 20 ms."""
        begin, end = bisect_left(self._last_ns, from_ns), bisect_right(self._first_ns, until_ns)
        blocks = self._blocks[begin:end]
        lows = [block.low_n for block in blocks if block.low_n is not None]
        highs = [block.high_n for block in blocks if block.high_n is not None]
        full, less = sum(block.full for block in blocks), sum(block.less for block in blocks)
        return Stretch(min(lows, default=None), max(highs, default=None), full, less)

    def newest_ns(self, at_ns: int) -> int | None:
        """Return the time of the newest tick before `at_ns`; None before the first."""
        number = bisect_right(self._first_ns, at_ns)
        return min(at_ns, self._last_ns[number - 1]) if number else None
