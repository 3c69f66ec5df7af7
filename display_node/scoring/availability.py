"""Availability and interruptions of the pulse, counted from a display's ticks. Pure."""

import numpy as np

from protocol.summary.fields import STATES, Availability, Interruptions
from protocol.ticks import DISPLAY_STATES, Integers

# A display's state → the key that it is counted under, if that differs.
_KEYS = {"playing": "felt", "fault": "faulted"}


class AvailabilityCounter:
    """Counter of a display's ticks by its state."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._ticks = np.zeros(len(DISPLAY_STATES), np.int64)
        self._all = 0

    def add(self, states: Integers, elapsed_ticks: Integers) -> None:
        """Count ticks by the numbers of their states, each some ticks after the one before."""
        self._ticks += np.bincount(states, minlength=len(DISPLAY_STATES))
        self._all += int(elapsed_ticks.sum())

    def availability(self, played_ticks: int) -> Availability:
        """Return the shares so far; played_ticks: number of ticks in which a pulse was played."""
        if not self._all:
            return Availability()
        counts = self._ticks.tolist()
        keys = (_KEYS.get(state, state) for state in DISPLAY_STATES)
        ticks = dict(zip(keys, counts, strict=True))
        ticks |= {"missed": self._all - sum(counts), "played": played_ticks}
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

    def add(self, full: Integers, elapsed_ticks: Integers) -> None:
        """Count ticks, at full strength or not, each some ticks after the one before."""
        numbers = self._ticks + elapsed_ticks.cumsum()
        self._ticks = int(numbers[-1])
        if full.all() and not self._interrupted:
            self._full = self._ticks
            return
        # Stretches of ticks that are all at full strength, or are not.
        ends = np.append(full[1:] != full[:-1], True).nonzero()[0]
        firsts = numbers[np.append(0, ends[:-1] + 1)].tolist()
        stretches = zip(full[ends].tolist(), firsts, numbers[ends].tolist(), strict=True)
        for is_full, first, last in stretches:
            if not is_full:
                self._interrupted = self._full is not None
                continue
            if self._interrupted and self._full is not None:
                self._interrupted = False
                self._last = self._full, first
                ticks = first - self._full
                self._count += 1
                self._interrupted_ticks += ticks
                self._longest = max(self._longest, ticks)
            self._full = last

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
