"""The statements of a display about itself: in its statuses, and in the lines of a terminal."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

_LINE = re.compile(r"(?P<state>[a-z]+)(?: (?P<age>\d+\.\d) s ago)?(?:: .*)?")
_PRESSED = re.compile(r"pressed with (-?\d+) mN")
_FINGER = re.compile(r"finger:? (not pressed|pressed with -?\d+ mN)")
_FELT = re.compile(r" felt (-?\d+)(?:, .*)? of -?\d+.* mN")
_HEART_RATE = re.compile(r"heart rate (\d+) /min")
_CURRENT_FINGER = re.compile(r"(?:: |, )finger ")
STATES = ("waiting", "starting", "playing", "stale", "ended", "fault")


@dataclass(frozen=True, slots=True)
class StatusClaim:
    """A status, with the record at its arrival.

    arrived_ns, tick_ns: arrival of the status, and time of the newest tick before it. felt_n, full:
    felt force and full strength at that tick. ticks, full_ticks: numbers recorded until then.
    no_figures: keys of the status with NaN or infinity.
    """

    arrived_ns: int
    tick_ns: int
    felt_n: float
    full: bool
    ticks: int
    full_ticks: int
    state: str
    final: bool
    summary: Mapping[str, Any]
    no_figures: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LineClaim:
    """A line of a terminal.

    age_s: the stated age; None if the line claims to be current. forces_n: the stated felt forces
    in N. heart_rate_per_min: None if the line has none. finger: the line states the finger's
    present condition. silent: the line states that no telemetry arrives.
    """

    read_ns: int
    text: str
    state: str
    age_s: float | None
    forces_n: tuple[float, ...]
    not_pressed: bool
    heart_rate_per_min: float | None
    finger: bool
    silent: bool


def pressed_n(finger: str) -> float | None:
    """Return the force in N of a sentence such as "pressed with 245 mN"; None where it has none."""
    found = _PRESSED.search(finger)
    return None if found is None else float(found[1]) * 1e-3


def read_line(text: str, read_ns: int) -> LineClaim | None:
    """Return the statements of a terminal's line; None for one that shows no display yet."""
    found = _LINE.fullmatch(text)
    if found is None or found["state"] not in STATES:
        return None
    sentences = _FINGER.findall(text)
    forces_n = [force_n for words in sentences if (force_n := pressed_n(words)) is not None]
    forces_n += [float(number) * 1e-3 for number in _FELT.findall(text)]
    rate = _HEART_RATE.search(text)
    return LineClaim(
        read_ns,
        text,
        found["state"],
        None if found["age"] is None else float(found["age"]),
        tuple(forces_n),
        "not pressed" in sentences,
        None if rate is None else float(rate[1]),
        _CURRENT_FINGER.search(text) is not None,
        "no telemetry" in text,
    )


def no_figures(value: Any, key: str = "") -> Iterator[str]:
    """Yield the keys of a message whose values are NaN or infinite."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from no_figures(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(value, (list, tuple)):
        for number, inner in enumerate(value):
            yield from no_figures(inner, f"{key}[{number}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield key
