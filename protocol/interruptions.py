"""Interruptions of the pulse: how often and how long it was not felt at its full strength. Pure.

Statuses come five times a second, and a state between two of them is in none. So the display counts
interruptions itself, tick by tick.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from protocol.counted import counted


@dataclass(frozen=True, slots=True)
class Interruptions:
    """Times from one tick at full strength to the next one, with others between; those that are
    over. count; seconds: all of them together; longest_s; began_s, ended_s: of the last one, in s
    of the run."""

    count: int | None = None
    seconds: float | None = None
    longest_s: float | None = None
    began_s: float | None = None
    ended_s: float | None = None


class InterruptionCounter:
    """Counts the interruptions of a run."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._ticks = self._count = self._all = self._longest = 0
        # The last tick at full strength, and whether one without it followed.
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
            self._all += ticks
            self._longest = max(self._longest, ticks)
        self._full = self._ticks

    def interruptions(self) -> Interruptions:
        """Return the interruptions so far."""
        if not self._ticks:
            return Interruptions()
        if self._last is None:
            return Interruptions(0, 0.0)
        seconds = (ticks * self._tick_s for ticks in (self._all, self._longest, *self._last))
        return Interruptions(self._count, *seconds)


def interruptions_text(known: Mapping[str, Any]) -> str | None:
    """Return the interruptions of a run in one phrase; None where there was none.

    Parameters
    ----------
    known : mapping
        `Interruptions` as a summary's JSON has it.
    """
    count, seconds, longest_s = (known.get(key) for key in ("count", "seconds", "longest_s"))
    if not count or seconds is None or longest_s is None:
        return None
    times = counted(count, "time")
    return f"{times}, {seconds:.2f} s in all, the longest {longest_s:.2f} s"
