"""Log of the felt force of a display, from its telemetry: times and bounds."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from protocol.wire.telemetry import Trace

# Ticks further apart belong to two spells: a tick or a trace may be late.
GAP_NS = 50_000_000
# The pulse counts as felt again when it has been felt for this time.
HOLD_NS = 200_000_000
# The effect of a missed tick is corrected within this time.
SETTLED_NS = 100_000_000
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(slots=True)
class FeltLog:
    """The times and bounds of the force of one display.

    spells: start and end of each time with the pulse at full strength, on this machine's clock.
    Forces in N: least and greatest of the target and of the felt force; slews in N/s: the largest.
    catching_up: slew of the felt force soon after missed ticks. The actuator keeps its last speed
    during these, and the resulting error is corrected faster than a target moves.
    """

    tick_ns: int
    spells: list[tuple[int, int]] = field(default_factory=list)
    ticks: int = 0
    target_n: tuple[float, float] = (0.0, 0.0)
    felt_n: tuple[float, float] = (0.0, 0.0)
    target_slew_n_per_s: float = 0.0
    felt_slew_n_per_s: float = 0.0
    catching_up_n_per_s: float = 0.0
    not_finite: int = 0
    _last: tuple[int, float, float] | None = None
    _missed_ns: int = 0

    def add(self, trace: Trace) -> None:
        """Add the ticks of a trace."""
        self.ticks += len(trace.now_ns)
        for values in (trace.target_n, trace.felt_n):
            self.not_finite += int(np.count_nonzero(~np.isfinite(values)))
        self.target_n = _spread(self.target_n, trace.target_n)
        self.felt_n = _spread(self.felt_n, trace.felt_n)
        now_ns, target_n, felt_n = trace.now_ns, trace.target_n, trace.felt_n
        if self._last is not None:
            last_ns, last_target_n, last_felt_n = self._last
            now_ns = np.concatenate(([last_ns], now_ns))
            target_n = np.concatenate(([last_target_n], target_n))
            felt_n = np.concatenate(([last_felt_n], felt_n))
        self._last = int(now_ns[-1]), float(target_n[-1]), float(felt_n[-1])
        self._slew(now_ns, target_n, felt_n)
        for at_ns, scored in zip(trace.now_ns.tolist(), trace.scored.tolist(), strict=True):
            if scored:
                self._touch(at_ns)

    def _slew(self, now_ns: Ints, target_n: Floats, felt_n: Floats) -> None:
        apart_ns = np.diff(now_ns)
        targets, felts = np.abs(np.diff(target_n)), np.abs(np.diff(felt_n))
        for end_ns, step_ns, target_step_n, felt_step_n in zip(
            now_ns[1:].tolist(), apart_ns.tolist(), targets.tolist(), felts.tolist(), strict=True
        ):
            # No slew across a change of process, or between two ticks at one time.
            if not 0 < step_ns < GAP_NS:
                self._missed_ns = end_ns
                continue
            seconds = step_ns * 1e-9
            self.target_slew_n_per_s = max(self.target_slew_n_per_s, target_step_n / seconds)
            if step_ns > self.tick_ns:
                self._missed_ns = end_ns
            slew_n_per_s = felt_step_n / seconds
            if end_ns - self._missed_ns < SETTLED_NS:
                self.catching_up_n_per_s = max(self.catching_up_n_per_s, slew_n_per_s)
            else:
                self.felt_slew_n_per_s = max(self.felt_slew_n_per_s, slew_n_per_s)

    def _touch(self, at_ns: int) -> None:
        spells = self.spells
        if spells and at_ns - spells[-1][1] < GAP_NS:
            spells[-1] = spells[-1][0], at_ns
        else:
            spells.append((at_ns, at_ns))


def _spread(spread: tuple[float, float], values: Floats) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    return (
        float(np.min(finite, initial=spread[0])),
        float(np.max(finite, initial=spread[1])),
    )


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
    longest_ns, felt_ns = 0, from_ns
    for begin_ns, end_ns in spells:
        if end_ns <= from_ns:
            continue
        if begin_ns >= until_ns:
            break
        longest_ns = max(longest_ns, begin_ns - felt_ns)
        felt_ns = max(felt_ns, end_ns)
    return max(longest_ns, until_ns - felt_ns)
