"""Shares of a display's run by its state. Pure.

The whole time of the run is counted, also ticks that the loop missed. So a share of a part of the
time, such as the time within the JND, can be printed with the part that it is of.

Interruptions of the pulse: how often and how long it was not felt at its full strength. Pure.

Statuses come five times a second, and a state between two of them is in none. So the display counts
interruptions itself, tick by tick.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from protocol.config.quantities import count_text


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
    times = count_text(count, "time")
    return f"{times}, {seconds:.2f} s in all, the longest {longest_s:.2f} s"


# Key of `Availability` → what people read; these shares add up to 1.
NAMES = {
    "felt": "felt",
    "starting": "starting",
    "stale": "stale",
    "faulted": "faulted",
    "waiting": "waiting",
    "ended": "ended",
    "missed": "missed ticks",
}
# A display's state → the key that it is counted under.
_KEYS = {
    "playing": "felt",
    "starting": "starting",
    "stale": "stale",
    "fault": "faulted",
    "waiting": "waiting",
    "ended": "ended",
}


@dataclass(frozen=True, slots=True)
class Availability:
    """Length of the run in s, and shares of it from 0 to 1.

    felt: the pulse was felt at its full strength. starting: it was ramped up. stale: no samples
    to play. faulted: a fault had latched. waiting: no stream, or its clock not known yet. ended:
    after the end of the stream. missed: ticks that did not run. These add up to 1.

    played: samples or their prediction were played, at full strength or in a ramp; what
    `compensation` is a share of. judged: the force felt could be compared with the pulse; what
    `within_jnd` is a share of.
    """

    seconds: float | None = None
    felt: float | None = None
    starting: float | None = None
    stale: float | None = None
    faulted: float | None = None
    waiting: float | None = None
    ended: float | None = None
    missed: float | None = None
    played: float | None = None
    judged: float | None = None


class AvailabilityCounter:
    """Counts the ticks of a display by its state."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._ticks: Counter[str] = Counter()
        self._all = self._missed = 0

    def add(self, state: str, elapsed_ticks: int) -> None:
        """Count a tick in a state, `elapsed_ticks` after the last one that ran."""
        self._ticks[state] += 1
        self._all += elapsed_ticks
        self._missed += elapsed_ticks - 1

    def availability(self, played_ticks: int) -> Availability:
        """Return the shares so far; played_ticks: how many ticks played something."""
        if not self._all:
            return Availability()
        shares = {key: self._ticks[state] / self._all for state, key in _KEYS.items()}
        return Availability(
            self._all * self._tick_s,
            missed=self._missed / self._all,
            played=played_ticks / self._all,
            **shares,
        )


def availability_text(shares: Mapping[str, Any]) -> str | None:
    """Return the shares that are not 0 in one phrase whose figures add up to 100.0 %; None while
    they are not known.

    Parameters
    ----------
    shares : mapping
        `Availability` as a summary's JSON has it.
    """
    known = {NAMES[key]: share for key in NAMES if (share := shares.get(key))}
    if shares.get("seconds") is None or not known:
        return None
    # Rounded down, what is missing at 100.0 % goes to those that lost most.
    tenths = {name: int(1000 * share) for name, share in known.items()}
    missing = round(1000 * sum(known.values())) - sum(tenths.values())
    for name in sorted(known, key=lambda name: tenths[name] - 1000 * known[name])[:missing]:
        tenths[name] += 1
    texts = [f"{name} {_tenths(tenths[name])}" for name in known]
    return f"{', '.join(texts)} of {shares['seconds']:.1f} s"


def _tenths(tenths: int) -> str:
    return f"{tenths / 10:.1f} %" if tenths else "< 0.1 %"


def part_text(share: float | None) -> str:
    """Return the part of the time that another share is of: "the 16.7 %", "the time"."""
    return "the time" if share is None else f"the {100 * share:.1f} % of the run"
