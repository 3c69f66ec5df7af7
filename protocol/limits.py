"""Counts of how often and for how long a quantity is held at one of its limits.

Both nodes count where they bound a quantity.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from protocol.figures import SECONDS, SHARE, Surface, absent, described_fields, figure, table


@dataclass(frozen=True, slots=True)
class Limited:
    """Figures of one limit; None where the limit does not apply."""

    times: int | None = figure("How often the limit was reached", metric="limited", counter=True)
    seconds: float | None = figure(
        "Time at the limit", unit=SECONDS, metric="limited_seconds", counter=True
    )
    share: float | None = figure(
        "Share of the ticks run, or of the samples taken, at the limit",
        unit=SHARE,
        absent=absent("Follows from time at the limit and time of the run.", Surface.METRICS),
    )


def _limit(name: str, key: str) -> Any:
    return table(Limited, name, labels={"limit": key})


@dataclass(frozen=True, slots=True)
class Limits:
    """Figures of each limit.

    Attributes
    ----------
    force, negative, slew : Limited
        Bounds on the force to be felt (`safety`): the force limit; a force below 0 N by more than
        1 mN, which cannot be played; the slew limit at full strength, ramps and fades left out.
    travel : Limited
        The end of the actuator's travel towards the finger; on a real bench also the braking
        before it.
    film, adc : Limited
        Ranges of the modelled feedback film's ADC and of the sensing node's ADC.
    """

    force: Limited = _limit("force limit", "force")
    negative: Limited = _limit("force below 0 N", "negative")
    slew: Limited = _limit("slew limit", "slew")
    travel: Limited = _limit("end of travel", "travel")
    film: Limited = _limit("film's ADC range", "film")
    adc: Limited = _limit("ADC range", "adc")


# Key of `Limits` → the limit's name for people.
NAMES = {key: row.name for key, (_, row) in described_fields(Limits).items()}


class LimitCounter:
    """Counter of the ticks (or samples) at a limit, and of the times it was reached."""

    __slots__ = ("_limited", "ticks", "times")

    def __init__(self) -> None:
        self._limited = False
        self.ticks = self.times = 0

    def add(self, limited: bool, ticks: int = 1) -> None:
        """Count `ticks` ticks that were all at the limit, or were not."""
        if limited:
            self.ticks += ticks
            self.times += not self._limited
        self._limited = limited

    def add_all(self, limited: NDArray[np.bool_]) -> None:
        """Count consecutive ticks or samples, shape (n,)."""
        if not len(limited):
            return
        self.ticks += int(np.count_nonzero(limited))
        rises = limited[1:] & ~limited[:-1]
        self.times += int(np.count_nonzero(rises)) + int(limited[0] and not self._limited)
        self._limited = bool(limited[-1])

    def limited(self, period_s: float, total_ticks: int) -> Limited:
        """Return the figures so far.

        Parameters
        ----------
        period_s : float
            Time of one tick or sample, in s.
        total_ticks : int
            All ticks of the run, at a limit or not.
        """
        share = self.ticks / total_ticks if total_ticks else 0.0
        return Limited(self.times, self.ticks * period_s, share)


def limit_texts(limits: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return one phrase for each limit that was reached, the one that held longest first.

    Parameters
    ----------
    limits : mapping
        `Limits` as a summary's JSON has it: a table of times, seconds and share for each key.
    """
    reached = [(NAMES[key], limits[key]) for key in NAMES if limits.get(key, {}).get("times")]
    reached.sort(key=lambda named: -(named[1].get("seconds") or 0.0))
    return [_text(name, limited) for name, limited in reached]


def longest_limit_text(limits: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the time at the limit that held longest; empty while no limit is known to apply."""
    known = [limit for limit in limits.values() if limit.get("times") is not None]
    seconds = [limit.get("seconds") or 0.0 for limit in known if limit["times"]]
    return f"{max(seconds):.1f} s" if seconds else "never" if known else ""


def _text(name: str, limited: Mapping[str, Any]) -> str:
    times, seconds, share = (limited.get(key) or 0 for key in ("times", "seconds", "share"))
    text = f"{name} {count_text(times, 'time')}, {_seconds(seconds)}"
    return f"{text} ({_percent(share)} of the run)"


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds >= 0.1 else f"{seconds * 1e3:.3g} ms"


def _percent(share: float) -> str:
    """Percent with one digit; what is more than nothing is not printed as 0.0 %."""
    return "< 0.1 %" if 0 < share < 5e-4 else f"{100 * share:.1f} %"
