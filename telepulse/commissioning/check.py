"""Verdict of a check: ok, look (it works, but not as it should) or fail, and why."""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "look", "fail"]


@dataclass(frozen=True, slots=True)
class Check:
    """One line of a bench check."""

    name: str
    found: str
    verdict: Verdict = "ok"
    reason: str = ""


def doubted(check: Check, reason: str) -> Check:
    """Return the check, at best "look" for a reason; one that is not "ok" keeps its own."""
    if not reason or check.verdict != "ok":
        return check
    return Check(check.name, check.found, "look", reason)


def graded(name: str, found: str, value: float, look: float, fail: float, reason: str) -> Check:
    """A check of a value that should be small: above `look` or `fail`, the reason is told."""
    if not value <= fail:
        return Check(name, found, "fail", reason)
    if value > look:
        return Check(name, found, "look", reason)
    return Check(name, found)
