"""The ticks of a display over all its processes, from its traces: what was felt, and when."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from protocol.wire.telemetry import Trace
from soak.core_time import missed_ticks
from tests.support.felt_force import FeltForce

# Ticks further apart belong to two spells: a tick or a trace may be late.
GAP_NS = 50_000_000
# The pulse counts as felt again when it has been felt for this time.
HOLD_NS = 200_000_000
# The effect of a missed tick is corrected within this time.
SETTLED_NS = 100_000_000
# A trace covers this time; statuses and lines are compared with whole traces.
TRACE_NS = 20_000_000
Floats = NDArray[np.float64]


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


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of the force of a display.

    Forces in N: least and greatest of the target and of the felt force, 0 N included; slews in N/s:
    the largest. catching_up: slew of the felt force soon after missed ticks. The actuator keeps its
    last speed during these, and the resulting error is corrected faster than a target moves.
    """

    ticks: int
    target_n: tuple[float, float] = (0.0, 0.0)
    felt_n: tuple[float, float] = (0.0, 0.0)
    target_slew_n_per_s: float = 0.0
    felt_slew_n_per_s: float = 0.0
    catching_up_n_per_s: float = 0.0
    not_finite: int = 0


NOTHING = Trace(*(np.empty(0, kind) for kind in (int, int, float, float, bool)))


class _Ticks:
    """All ticks so far. within: of each pair of neighbours, whether one process made them."""

    def __init__(self, trace: Trace, process: NDArray[np.int64]) -> None:
        self.trace, self.now_ns, self.full = trace, trace.now_ns, trace.full
        self.within = process[1:] == process[:-1]
        self.apart_ns = np.diff(trace.now_ns)

    @cached_property
    def spells(self) -> list[tuple[int, int]]:
        at_ns = self.now_ns[self.full]
        ends = np.flatnonzero(np.diff(at_ns) >= GAP_NS) + 1
        parts = pairwise([0, *ends.tolist(), len(at_ns)])
        return [(int(at_ns[a]), int(at_ns[b - 1])) for a, b in parts if b > a]


class FeltLog(FeltForce):
    """The ticks of one display; times on this machine's clock in ns.

    ticks, full: numbers of ticks, and of those at full strength. last: time, felt force and full
    strength of the newest tick of the present process; None before its first.
    """

    def __init__(self, tick_ns: int) -> None:
        super().__init__()
        self.tick_ns = tick_ns
        self.ticks = self.full = 0
        self.last: tuple[int, float, bool] | None = None
        self._process, self._processes = 0, list[int]()
        self._known: tuple[int, _Ticks] | None = None

    def begin_process(self) -> None:
        """Expect the ticks of another process: the time between the two is no interruption."""
        self._process += 1
        self.last = None

    def add_trace(self, trace: Trace) -> None:
        """Add the ticks of a trace. Copies: a trace is a view of a longer message."""
        now_ns, full = trace.now_ns.copy(), trace.full.copy()
        felt_n = trace.felt_n.copy()
        self.add([Trace(now_ns, now_ns, trace.target_n.copy(), felt_n, full)])
        self._processes.append(self._process)
        self.ticks += len(now_ns)
        self.full += int(np.count_nonzero(full))
        self.last = int(now_ns[-1]), float(felt_n[-1]), bool(full[-1])

    @property
    def _all(self) -> _Ticks:
        count = len(self._processes)
        if self._known is None or self._known[0] != count:
            lengths = [len(traces[0].now_ns) for traces in self.traces]
            process = np.repeat(np.array(self._processes, np.int64), np.array(lengths, int))
            self._known = count, _Ticks(self.trace() if count else NOTHING, process)
        return self._known[1]

    @property
    def spells(self) -> list[tuple[int, int]]:
        """Return start and end of each time with the pulse at full strength."""
        return self._all.spells

    @property
    def interruptions(self) -> list[tuple[int, int, int]]:
        """Return each time without full strength within one process, and its number of ticks."""
        every = self._all
        full = np.flatnonzero(every.full)
        changes = np.concatenate([[0], np.cumsum(~every.within)])
        return [
            (int(every.now_ns[a]), int(every.now_ns[b]), int(b - a - 1))
            for a, b in pairwise(full.tolist())
            if b - a > 1 and changes[a] == changes[b]
        ]

    @property
    def misses(self) -> list[tuple[int, int, int]]:
        """Return times of the ticks before and after missed ones, and the number missed."""
        return missed_ticks(self._all.now_ns, self.tick_ns, self._all.within)

    @property
    def gaps(self) -> list[tuple[int, int, bool]]:
        """Return each time of more than 50 ms without a tick; whether the next was at full."""
        every = self._all
        return [
            (int(every.now_ns[at]), int(every.now_ns[at + 1]), bool(every.full[at + 1]))
            for at in np.flatnonzero((every.apart_ns > GAP_NS) & every.within)
        ]

    def between(self, from_ns: int, until_ns: int) -> Stretch:
        """Return the force felt in an interval, and a trace's length around it."""
        every = self._all
        begin, end = np.searchsorted(every.now_ns, (from_ns - TRACE_NS, until_ns + TRACE_NS))
        felt_n, full = every.trace.felt_n[begin:end], int(np.count_nonzero(every.full[begin:end]))
        known_n = felt_n[np.isfinite(felt_n)]
        low_n, high_n = (known_n.min(), known_n.max()) if len(known_n) else (None, None)
        return Stretch(low_n, high_n, full, len(felt_n) - full)

    def newest_ns(self, at_ns: int) -> int | None:
        """Return the time of the newest tick before `at_ns`; None before the first."""
        now_ns = self._all.now_ns
        number = int(np.searchsorted(now_ns, at_ns, "right"))
        return int(now_ns[number - 1]) if number else None

    def bounds(self) -> Bounds:
        """Return the bounds of all ticks. There is no slew from one process to the next."""
        trace, apart_ns = self._all.trace, self._all.apart_ns
        each = (apart_ns > 0) & (apart_ns < GAP_NS)
        end_ns = trace.now_ns[1:]
        # For each tick, the time of the last one that came late.
        late_ns = np.where(each & (apart_ns <= self.tick_ns), 0, end_ns)
        catching_up = end_ns - np.maximum.accumulate(late_ns) < SETTLED_NS
        seconds = np.where(each, apart_ns, 1) * 1e-9
        target, felt = (
            np.nan_to_num(np.abs(np.diff(values_n)) / seconds)
            for values_n in (trace.target_n, trace.felt_n)
        )
        return Bounds(
            self.ticks,
            _spread(trace.target_n),
            _spread(trace.felt_n),
            float(np.max(target, where=each, initial=0.0)),
            float(np.max(felt, where=each & ~catching_up, initial=0.0)),
            float(np.max(felt, where=each & catching_up, initial=0.0)),
            sum(int((~np.isfinite(n)).sum()) for n in (trace.target_n, trace.felt_n)),
        )


def _spread(values_n: Floats) -> tuple[float, float]:
    finite_n = values_n[np.isfinite(values_n)]
    return float(np.min(finite_n, initial=0.0)), float(np.max(finite_n, initial=0.0))


def felt_again_ns(spells: list[tuple[int, int]], over_ns: int, until_ns: int) -> int | None:
    """Return the time in ns from `over_ns` until the pulse was felt again, steadily.

    None if it was not felt before `until_ns`.
    """
    for begin_ns, end_ns in spells:
        begin_ns = max(begin_ns, over_ns)
        if end_ns - begin_ns >= HOLD_NS and begin_ns < until_ns:
            return begin_ns - over_ns
    return None


def longest_gap_ns(spells: list[tuple[int, int]], from_ns: int, until_ns: int) -> int:
    """Return the longest time without the pulse in an interval."""
    felt = [(from_ns, from_ns), *((a, b) for a, b in spells if b > from_ns and a < until_ns)]
    ends = pairwise([*felt, (until_ns, until_ns)])
    return max(max(0, after[0] - before[1]) for before, after in ends)
