"""Times of a file: texts that state one, and repair of a few that are wrong.

A recorder's clock may be set back, and single time stamps may be wrong or unreadable. The samples
are those of a steady rate all the same, so that such times are replaced.
"""

import re
from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from sensing_node.files.column_kind import TIME, named_kind, seconds_of
from sensing_node.files.recording_plausibility import GAP_STEPS
from sensing_node.files.signals import Floats

# Greatest share of wrong time stamps, and most steps back, of a column of times.
MOST_WRONG, MOST_STEPS_BACK = 0.01, 20
FEW_WRONG = 2
DAY_S = 86_400.0
_ELAPSED = re.compile(r"(?:(\d+)[:h ])?(\d{1,3})[:m](\d{1,2}(?:[.,]\d+)?)s?")
_DATE = re.compile(r"(\d{1,2})([./-])(\d{1,2})\2(\d{4})[T ,]+(\d{1,2}:\d\d(?::\d\d(?:[.,]\d+)?)?)")


def are_times(name: str, unit: str) -> bool:
    """Return whether a column holds times by its name or its unit."""
    return named_kind(name) == TIME or seconds_of(unit or name) is not None


def time_of(text: str) -> float | None:
    """Return the time in s that a text states: one of day, an elapsed one, or a date; or None.

    A date without a zone is taken as UTC. Of 5/6/2024, the first is the month; of 5.6.2024, the
    day.
    """
    text = text.strip(" \t'\"[]")
    if (found := _ELAPSED.fullmatch(text)) is not None:
        hours, minutes, seconds = found.groups()
        return int(hours or 0) * 3600.0 + int(minutes) * 60 + float(seconds.replace(",", "."))
    if (found := _DATE.fullmatch(text)) is not None:
        first, mark, second, year, clock = found.groups()
        month_first = mark == "/" and int(first) <= 12
        month, day = (first, second) if month_first else (second, first)
        clock = clock if clock[1] != ":" else f"0{clock}"
        text = f"{year}-{int(month):02}-{int(day):02}T{clock.replace(',', '.')}"
    try:
        at = datetime.fromisoformat(text.replace(" UTC", "+00:00"))
        return at.replace(tzinfo=at.tzinfo or UTC).timestamp()
    except (ValueError, OverflowError):
        return None


def repaired(
    times: Floats, title: str, place: Callable[[int], str]
) -> tuple[Floats, list[str]] | None:
    """Return times that never fall, and a line on each kind of change; None if too many are wrong.

    times: in any unit; NaN where one cannot be read. place: returns the place in the file of a
    sample, by its number: "row 12".
    """
    unread = np.flatnonzero(~np.isfinite(times))
    notes: list[str] = []
    if len(unread) or np.any(times[1:] < times[:-1]):
        times = times.copy()
        known = np.isfinite(times)
        steps = np.diff(times[known])
        usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
        wrong = np.union1d(unread, _apart(times, usual))
        if not usual or len(wrong) > max(FEW_WRONG, MOST_WRONG * len(times)):
            return None
        if len(wrong):
            first = int(wrong[0])
            stated = f", {times[first]:.10g}" if np.isfinite(times[first]) else ""
            count = count_text(len(wrong), "time is", "times are")
            which = "the first" if len(wrong) > 1 else "that"
            notes.append(f'column "{title}": {count} not used, {which} in {place(first)}{stated}')
            good = np.setdiff1d(np.arange(len(times)), wrong)
            times[wrong] = np.interp(wrong, good, times[good])
            # Before the first good time and after the last one, in usual steps.
            times[: good[0]] -= usual * np.arange(good[0], 0, -1)
            times[good[-1] + 1 :] += usual * np.arange(1, len(times) - good[-1])
        back = np.flatnonzero(times[1:] < times[:-1]) + 1
        if len(back) > MOST_STEPS_BACK:
            return None
        for at in back:
            step = float(times[at - 1] - times[at]) + usual
            times[at:] += step
            # A time of day begins again at midnight.
            if round(step) != DAY_S:
                notes.append(
                    f'column "{title}": was set back by {step:.6g} after {place(int(at) - 1)};'
                    " the samples after it are played right after it"
                )
    return times, notes


def _apart(times: Floats, usual: float) -> NDArray[np.intp]:
    """Return the numbers of single times that lie apart from both their neighbours."""
    before, after = times[1:-1] - times[:-2], times[2:] - times[1:-1]
    across = before + after
    even = (across >= 0) & (across <= 2 * GAP_STEPS * usual)
    return np.flatnonzero(((before < 0) | (after < 0)) & even) + 1
