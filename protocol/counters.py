"""Counters of a run, tick by tick: shares by state, interruptions, limits, errors by time. Pure.

The shares of `Availability` refer to the whole time, including the ticks that the loop missed.
States are counted tick by tick, not from the status messages: a state may begin and end between
two of those.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from protocol.figures import (
    NEWTONS,
    SECONDS,
    SHARE,
    Surface,
    absent,
    figure,
    figures_of,
    table,
    texts,
)

_LAST = "Of the last interruption, in s of the run"
_IN_EVENTS = absent("It is an instant, which the events show.")


def _state(meaning: str, key: str, text: str = "") -> Any:
    metric = f'availability_ratio{{state="{key}"}}'
    return figure(meaning, text or key, SHARE, metric=metric, help="Share of the run by state.")


@dataclass(frozen=True, slots=True)
class Availability:
    """Length of the run, and shares of it. Those by state, and `missed`, add up to 1."""

    seconds: float | None = figure(
        "Time of the run, missed ticks included", unit=SECONDS, metric="run_seconds"
    )
    felt: float | None = _state("The pulse was felt at its full strength", "felt")
    starting: float | None = _state("The pulse was ramped up, or faded out", "starting")
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
        metric="judged_ratio",
        absent=absent("The page has that of its window.", Surface.PAGE),
    )


# Key of each share by state → its name for people.
STATE_NAMES = {
    each.key: each.text for each in figures_of(Availability) if each.metric == "availability_ratio"
}


def availability_text(shares: Mapping[str, Any]) -> str | None:
    """Return the shares that are not 0 in one phrase whose figures add up to 100.0 %.

    shares: `Availability` as a summary's JSON has it. Returns None before the first tick.
    """
    known = {name: share for key, name in STATE_NAMES.items() if (share := shares.get(key))}
    if shares.get("seconds") is None or not known:
        return None
    # All are rounded down; the remainder to 100.0 % is given to those that lost most.
    tenths = {name: int(1000 * share) for name, share in known.items()}
    missing = round(1000 * sum(known.values())) - sum(tenths.values())
    for name in sorted(known, key=lambda name: tenths[name] - 1000 * known[name])[:missing]:
        tenths[name] += 1
    texts = [f"{name} {n / 10:.1f} %" if n else f"{name} < 0.1 %" for name, n in tenths.items()]
    return f"{', '.join(texts)} of {shares['seconds']:.1f} s"


@dataclass(frozen=True, slots=True)
class Interruptions:
    """Ended interruptions: from the last full-strength tick before to the first one after it."""

    count: int | None = figure(
        "Ended interruptions of the pulse, each from the last tick at full strength before it to"
        " the first one after it",
        metric="interruptions_total",
    )
    seconds: float | None = figure(
        "Time of all interruptions", unit=SECONDS, metric="interrupted_seconds"
    )
    longest_s: float | None = figure(
        "Longest interruption", unit=SECONDS, metric="longest_interruption_seconds"
    )
    began_s: float | None = figure(f"{_LAST}: its begin", unit=SECONDS, absent=_IN_EVENTS)
    ended_s: float | None = figure(f"{_LAST}: its end", unit=SECONDS, absent=_IN_EVENTS)


def interruptions_text(known: Mapping[str, Any]) -> str | None:
    """Return the interruptions of a run, as JSON has them, in one phrase; None without any."""
    count, seconds, longest_s = (known.get(key) for key in ("count", "seconds", "longest_s"))
    if not count or seconds is None or longest_s is None:
        return None
    return f"{count_text(count, 'time')}, {seconds:.2f} s in all, the longest {longest_s:.2f} s"


@dataclass(frozen=True, slots=True)
class Limited:
    """Figures of one limit; None where the limit does not apply."""

    times: int | None = figure("How often the limit was reached", metric="limited_total")
    seconds: float | None = figure(
        "Time at the limit", unit=SECONDS, metric="limited_seconds_total"
    )
    share: float | None = figure(
        "Share of the ticks run, or of the samples taken, at the limit",
        unit=SHARE,
        absent=absent("Follows from time at the limit and time of the run.", Surface.METRICS),
    )


def _limit(name: str, key: str) -> Any:
    return table(Limited, name, metric=f'{{limit="{key}"}}')


@dataclass(frozen=True, slots=True)
class Limits:
    """Figures of each limit.

    `Safety` applies the first three to the target force. force: the force limit. negative: the
    bound at 0 N, counted where the target is more than 1 mN below it. slew: the slew limit at full
    strength, without ramps and fades. travel: the end of the actuator's travel towards the finger,
    on a real bench with the braking before it. film: the ADC range of the modelled film. adc: that
    of the sensing node.
    """

    force: Limited = _limit("force limit", "force")
    negative: Limited = _limit("force below 0 N", "negative")
    slew: Limited = _limit("slew limit", "slew")
    travel: Limited = _limit("end of travel", "travel")
    film: Limited = _limit("film's ADC range", "film")
    adc: Limited = _limit("ADC range", "adc")


# Key of `Limits` → the limit's name for people.
LIMIT_NAMES = {each.key.partition(".")[0]: each.row for each in figures_of(Limits)}


def limit_texts(limits: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return one phrase for each limit that was reached, the one that held longest first.

    limits: `Limits` as a summary's JSON has it: times, seconds and share for each key.
    """
    found = []
    for key, name in LIMIT_NAMES.items():
        times, seconds, share = (
            limits.get(key, {}).get(each) or 0 for each in ("times", "seconds", "share")
        )
        if times:
            held = f"{seconds:.1f} s" if seconds >= 0.1 else f"{seconds * 1e3:.3g} ms"
            # A share above 0 is not printed as 0.0 %.
            percent = "< 0.1" if 0 < share < 5e-4 else f"{100 * share:.1f}"
            text = f"{name} {count_text(times, 'time')}, {held} ({percent} % of the run)"
            found.append((seconds, text))
    return [text for _, text in sorted(found, key=lambda one: -one[0])]


def longest_limit_text(limits: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the time at the limit that held longest; empty while no limit is known to apply."""
    known = [limit for limit in limits.values() if limit.get("times") is not None]
    seconds = [limit.get("seconds") or 0.0 for limit in known if limit["times"]]
    return f"{max(seconds):.1f} s" if seconds else "never" if known else ""


# The first windows are of a second, while clock, buffer and predictor settle. Each further one is
# as long as all before it.
SINGLE_SECONDS = 15


@dataclass(frozen=True, slots=True)
class ErrorWindow:
    """Errors in a part of the run, and its times in s after the first judged tick.

    playout_delay_ms: mean perceived delay E. aligned_n, in_phase_n: RMS error in N.
    """

    from_s: float
    to_s: float
    playout_delay_ms: float
    aligned_n: float | None
    in_phase_n: float | None


class ErrorWindowCounter:
    """Counter of errors and perceived delays by windows of time."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._last_s = 0.0
        # By window, for E in ns and the squares of both errors: the sum and the number of ticks.
        self._sums: list[NDArray[np.float64]] = []

    def add(
        self,
        now_ns: NDArray[np.int64],
        delay_ns: NDArray[np.int64],
        aligned_n: NDArray[np.float64],
        in_phase_n: NDArray[np.float64],
    ) -> None:
        """Add consecutive ticks, each array of shape (n,). An unknown error is NaN."""
        if self._first_ns is None:
            self._first_ns = int(now_ns[0])
        values = np.array((delay_ns, aligned_n**2, in_phase_n**2), np.float64)
        since_ns = now_ns - self._first_ns
        while len(since_ns):
            # A step of the clock may lead back before the first tick.
            window = _window_at(max(int(since_ns[0]), 0) * 1e-9)
            end_ns = round(_window_begins_s(window + 1) * 1e9)
            ticks = max(1, int(np.searchsorted(since_ns, end_ns)))
            self._add_to(window, values[:, :ticks])
            self._last_s = max(self._last_s, int(since_ns[ticks - 1]) * 1e-9)
            since_ns, values = since_ns[ticks:], values[:, ticks:]

    def _add_to(self, window: int, values: NDArray[np.float64]) -> None:
        while len(self._sums) <= window:
            self._sums.append(np.zeros((3, 2)))
        known = np.isfinite(values)
        # `cumsum` adds one value after the other, at any count of ticks.
        self._sums[window][:, 0] += np.where(known, values, 0.0).cumsum(axis=1)[:, -1]
        self._sums[window][:, 1] += known.sum(axis=1)

    def windows(self) -> list[ErrorWindow]:
        """Return the windows in which ticks were added."""
        found = []
        for number, sums in enumerate(self._sums):
            (delay_ns, ticks), *errors = sums.tolist()
            if ticks:
                to_s = min(_window_begins_s(number + 1), self._last_s)
                delay_ms = delay_ns / ticks * 1e-6
                rms_n = (math.sqrt(total / count) if count else None for total, count in errors)
                found.append(ErrorWindow(_window_begins_s(number), to_s, delay_ms, *rms_n))
        return found


def _window_at(since_s: float) -> int:
    if since_s < SINGLE_SECONDS:
        return int(since_s)
    return SINGLE_SECONDS + int(math.log2(since_s / SINGLE_SECONDS))


def _window_begins_s(number: int) -> float:
    return float(min(number, SINGLE_SECONDS) << max(number - SINGLE_SECONDS, 0))


def windows_text(windows: Sequence[Mapping[str, Any]]) -> str | None:
    """Return one line for each window, as JSON has them; None without any."""
    return largest_windows_text([windows])


def largest_windows_text(contactors: Sequence[Sequence[Mapping[str, Any]]]) -> str | None:
    """Return one line for each window, with the largest error of several contactors."""
    lines = []
    for each, *others in zip(*contactors, strict=False):
        # The last window ends with the run.
        until = f"{each['to_s']:.1f}".removesuffix(".0")
        times = f"{each['from_s']:.0f} to {until} s"
        # An E of 0 is known to the clock's error only; "z" prints no sign before a zero.
        parts = [f"{times}: E {each['playout_delay_ms']:z.1f} ms"]
        for name, key in (("aligned", "aligned_n"), ("in phase", "in_phase_n")):
            errors_n = [found[key] for found in (each, *others) if found[key] is not None]
            most = "at most " if others else ""
            parts.append(f"{name} {most}{NEWTONS.text(max(errors_n, default=None)) or 'unknown'}")
        lines.append(", ".join(parts))
    return texts(lines, "\n")
