"""Check that every sample is accounted for: those sent against a display's counts.

A display counts over all sessions of its process. Its count is checked whenever it has received the
end of a session (state "ended"): between two such times it must grow by exactly the samples sent.
If the end was not announced (a sensing node killed with SIGKILL, an end lost in a cut), the samples
sent since shortly before the fault may be missing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

# Samples of this time before a fault may be in transit, buffered, or not yet reported.
GRACE_NS = 1_000_000_000
# The effects of a fault last up to this time after its end: name look-up, connection.
AFTERMATH_NS = 3_000_000_000


@dataclass(frozen=True, slots=True)
class Session:
    """A run of a sensing node, with bounds of the number of samples that it has sent.

    began_ns: time of its first sample. least, most: the bounds; equal if the node reported the
    number, as nodes do at their end.
    """

    began_ns: int
    ended_ns: int
    period_ns: int
    least: int
    most: int


@dataclass(frozen=True, slots=True)
class Mark:
    """A display's state at a time. total: samples sent, by its counts, also before it joined."""

    now_ns: int
    state: str
    total: int


@dataclass(frozen=True, slots=True)
class Reckoning:
    """A display's count over one or more sessions, which must be between `least` and `most`.

    The bounds are equal if the display received every end.
    """

    counted: int
    least: int
    most: int

    @property
    def exact(self) -> bool:
        """Return whether the bounds are equal."""
        return self.least == self.most

    @property
    def off(self) -> int:
        """Return the number of samples unaccounted for; negative: counted too often."""
        return max(0, self.least - self.counted) or min(0, self.most - self.counted)


def reckon(
    marks: Sequence[Mark], sessions: Sequence[Session], faults: Sequence[tuple[int, int]]
) -> list[Reckoning]:
    """Return a display's counts from one reported end to the next, and to its own end.

    marks: its states, in order. sessions: all sessions during its process, in order. faults: start
    and end of each.
    """
    if not marks or not marks[-1].total:
        return []  # it never joined
    joined_ns = next(mark.now_ns for mark in marks if mark.total)
    found, base = [], 0
    least = most = 0
    for number, session in enumerate(sessions):
        following = sessions[number + 1].began_ns if number + 1 < len(sessions) else None
        reported = _reported(marks, session, following)
        if reported is not None:
            found.append(
                Reckoning(reported.total - base, least + session.least, most + session.most)
            )
            base, least, most = reported.total, 0, 0
        else:
            until_ns = min(session.ended_ns, marks[-1].now_ns)
            # A session that was over before the display first joined is not required.
            if session.ended_ns > joined_ns:
                least += max(0, min(session.least, _received_by(until_ns, session, faults)))
            most += min(session.most, _sent_by(marks[-1].now_ns, session))
    if most:
        found.append(Reckoning(marks[-1].total - base, least, most))
    return found


def _reported(marks: Sequence[Mark], session: Session, following_ns: int | None) -> Mark | None:
    """Return the last mark at which the display knew that the session was over."""
    after = [
        mark
        for mark in marks
        if mark.state == "ended"
        and mark.now_ns >= session.ended_ns
        and (following_ns is None or mark.now_ns < following_ns)
    ]
    return after[-1] if after else None


def _sent_by(now_ns: int, session: Session) -> int:
    """Return the largest number of samples that a session can have at a time."""
    return (now_ns - session.began_ns) // session.period_ns + 1


def _received_by(until_ns: int, session: Session, faults: Sequence[tuple[int, int]]) -> int:
    """Return the number of samples received and reported before a fault began."""
    for from_ns, to_ns in reversed(faults):
        if from_ns <= until_ns <= to_ns + AFTERMATH_NS:
            until_ns = from_ns
    return (until_ns - GRACE_NS - session.began_ns) // session.period_ns


def unaccounted(presses: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the accounts of set-points that do not add up; nodes without a press have none."""
    parts = ("applied", "superseded", "lost")
    return [
        f"{press['sent']} sent, {' + '.join(str(press[part]) for part in parts)}"
        for press in presses
        if press["sent"] is not None and press["sent"] != sum(press[part] for part in parts)
    ]
