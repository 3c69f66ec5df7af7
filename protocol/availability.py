"""Shares of a display's run by its state, and interruptions of the pulse. Pure.

The shares are of the whole time, with the ticks that the loop missed. Statuses come five times a
second, and a state between two of them is in none: the display counts tick by tick.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from protocol.config.quantities import count_text
from protocol.figures import SECONDS, SHARE, Surface, absent, described_fields, figure

_LAST = "Of the last interruption, in s of the run"
_IN_EVENTS = "An instant, not an amount: it is in the events."


@dataclass(frozen=True, slots=True)
class Interruptions:
    """Interruptions that are over: from one tick at full strength to the next, others between."""

    count: int | None = figure(
        "Interruptions of the pulse that are over: from one tick at full strength "
        "to the next, with others between",
        metric="interruptions",
        counter=True,
    )
    seconds: float | None = figure(
        "Time of all interruptions", unit=SECONDS, metric="interrupted_seconds"
    )
    longest_s: float | None = figure(
        "Longest interruption", unit=SECONDS, metric="longest_interruption_seconds"
    )
    began_s: float | None = figure(f"{_LAST}: its begin", unit=SECONDS, absent=absent(_IN_EVENTS))
    ended_s: float | None = figure(f"{_LAST}: its end", unit=SECONDS, absent=absent(_IN_EVENTS))


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
    """Return the interruptions of a run, as JSON has them, in one phrase; None without any."""
    count, seconds, longest_s = (known.get(key) for key in ("count", "seconds", "longest_s"))
    if not count or seconds is None or longest_s is None:
        return None
    times = count_text(count, "time")
    return f"{times}, {seconds:.2f} s in all, the longest {longest_s:.2f} s"


# A display's state → the key that it is counted under.
_KEYS = {
    "playing": "felt",
    "starting": "starting",
    "stale": "stale",
    "fault": "faulted",
    "waiting": "waiting",
    "ended": "ended",
}


def _state(meaning: str, key: str, text: str = "") -> Any:
    return figure(
        meaning,
        text or key,
        SHARE,
        metric="availability_ratio",
        labels={"state": key},
        help="Share of the run by state.",
    )


@dataclass(frozen=True, slots=True)
class Availability:
    """Length of the run, and shares of it. Those by state, and `missed`, add up to 1."""

    seconds: float | None = figure(
        "Time of the run, missed ticks included", unit=SECONDS, metric="run_seconds"
    )
    felt: float | None = _state("The pulse was felt at its full strength", "felt")
    starting: float | None = _state("The pulse was ramped up", "starting")
    stale: float | None = _state("No samples to play", "stale")
    faulted: float | None = _state("A fault had latched", "faulted")
    waiting: float | None = _state("No stream, or its clock was not known yet", "waiting")
    ended: float | None = _state("After the end of the stream", "ended")
    missed: float | None = _state("Ticks that did not run", "missed", "missed ticks")
    played: float | None = figure(
        "Samples or their prediction were played, at full strength or in a ramp",
        "",
        SHARE,
        metric="played_ratio",
    )
    judged: float | None = figure(
        "The force felt could be compared with the pulse",
        "",
        SHARE,
        absent=absent("The page has that of its window.", Surface.PAGE)
        | absent("The live view has no share of it.", Surface.TERMINAL),
        metric="judged_ratio",
    )


# Key of each share by state → its name for people.
NAMES = {
    name: each.text
    for name, (_, each) in described_fields(Availability).items()
    if each.metric == "availability_ratio"
}


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
    """Return the shares that are not 0 in one phrase whose figures add up to 100.0 %.

    Parameters
    ----------
    shares : mapping
        `Availability` as a summary's JSON has it.

    Returns
    -------
    str or None
        None before the first tick.
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
