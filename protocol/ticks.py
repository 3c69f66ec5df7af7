"""The state of a display's last tick, and counters of its ticks. Pure.

The counters give the figures of `protocol.summary.tables`.
"""

import math
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.summary.tables import STATES, Availability, Interruptions, Limited


@dataclass(slots=True)
class TickState:
    """State at the beginning of the last tick; `Trace` explains the fields that it shares."""

    now_ns: int = 0
    sensing_now_ns: int = 0
    instant_ns: int = 0
    target_n: float = 0.0
    felt_n: float = 0.0
    scored: bool = False
    predictor_error_n: float = math.nan
    trusted: bool = False
    press_n: float = math.nan
    hold_down_n: float = math.nan

    @property
    def playout_delay_ns(self) -> int:
        """The perceived delay E of this tick."""
        return self.sensing_now_ns - self.instant_ns


# A display's state → the key that it is counted under, if that differs.
_KEYS = {"playing": "felt", "fault": "faulted"}


class AvailabilityCounter:
    """Counter of a display's ticks by its state."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._ticks: defaultdict[str, int] = defaultdict(int)
        self._all = 0

    def add(self, state: str, elapsed_ticks: int) -> None:
        """Count a tick in a state, `elapsed_ticks` after the last one that ran."""
        self._ticks[state] += 1
        self._all += elapsed_ticks

    def availability(self, played_ticks: int) -> Availability:
        """Return the shares so far; played_ticks: number of ticks in which a pulse was played."""
        if not self._all:
            return Availability()
        ticks = {_KEYS.get(state, state): count for state, count in self._ticks.items()}
        ticks |= {"missed": self._all - sum(self._ticks.values()), "played": played_ticks}
        shares = {key: ticks.get(key, 0) / self._all for key in (*STATES, "played")}
        return Availability(self._all * self._tick_s, **shares)


class InterruptionCounter:
    """Counter of a run's interruptions."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._ticks = self._count = self._interrupted_ticks = self._longest = 0
        # The last tick at full strength, and whether a tick below full strength followed.
        self._full: int | None = None
        self._interrupted = False
        self._last: tuple[int, int] | None = None

    def add(self, full: bool, elapsed_ticks: int) -> None:
        """Count a tick, at full strength or not, `elapsed_ticks` after the last one that ran."""
        self._ticks += elapsed_ticks
        if not full:
            self._interrupted = self._full is not None
            return
        if self._interrupted and self._full is not None:
            self._interrupted = False
            self._last = self._full, self._ticks
            ticks = self._ticks - self._full
            self._count += 1
            self._interrupted_ticks += ticks
            self._longest = max(self._longest, ticks)
        self._full = self._ticks

    def interruptions(self) -> Interruptions:
        """Return the interruptions so far."""
        if not self._ticks:
            return Interruptions()
        if self._last is None:
            return Interruptions(0, 0.0)
        seconds = (
            ticks * self._tick_s for ticks in (self._interrupted_ticks, self._longest, *self._last)
        )
        return Interruptions(self._count, *seconds)


class LimitCounter:
    """Counter of the ticks (or samples) at a limit, and of the times it was reached.

    active: whether the last tick was at the limit. While it is False, `add(False)` changes nothing.
    """

    __slots__ = ("active", "ticks", "times")

    def __init__(self) -> None:
        self.active = False
        self.ticks = self.times = 0

    def add(self, limited: bool, ticks: int = 1) -> None:
        """Count `ticks` ticks that were all at the limit, or were not."""
        if limited:
            self.ticks += ticks
            self.times += not self.active
        self.active = limited

    def add_all(self, limited: NDArray[np.bool_]) -> None:
        """Count consecutive ticks or samples, shape (n,)."""
        if len(limited):
            self.ticks += int(np.count_nonzero(limited))
            before = np.concatenate([[self.active], limited[:-1]])
            self.times += int(np.count_nonzero(limited & ~before))
            self.active = bool(limited[-1])

    def limited(self, period_s: float, total_ticks: int) -> Limited:
        """Return the figures so far, of `total_ticks` ticks or samples of a period in s."""
        share = self.ticks / total_ticks if total_ticks else 0.0
        return Limited(self.times, self.ticks * period_s, share)
