"""Is every sample accounted for? What the sensing node sent, against what a display says of it.

A display counts over all sessions of its life, so it is held to account where a session is known to
be over and it has been told so (state "ended"): from one such moment to the next its count must
grow by exactly what was sent. A session that ended without a word (a sensing node killed with
SIGKILL, an end that a cut kept from the display) may lack its tail, for nobody told the display of
it: what was sent since shortly before the fault began.
"""

from collections.abc import Sequence
from dataclasses import dataclass

# Before a fault begins, this much may be on its way, wait to be played, or not be told yet.
GRACE_NS = 1_000_000_000
# A fault is still at work so long after its end: a name looked up, a connection made.
AFTERMATH_NS = 3_000_000_000


@dataclass(frozen=True, slots=True)
class Session:
    """One run of a sensing node: when its first sample was taken, when it was over, and between
    which counts what it has sent lies: the same where it said how many, as nodes do at their end.
    """

    began_ns: int
    ended_ns: int
    period_ns: int
    least: int
    most: int


@dataclass(frozen=True, slots=True)
class Mark:
    """What a display said of itself at one time. total: samples sent, by its account, with those
    before it joined.
    """

    now_ns: int
    state: str
    total: int


@dataclass(frozen=True, slots=True)
class Reckoning:
    """A display's count over one or more sessions: counted, between least and most is right.
    exact: least and most are the same, as the display was told of every end.
    """

    counted: int
    least: int
    most: int

    @property
    def exact(self) -> bool:
        """Whether there is only one right count."""
        return self.least == self.most

    @property
    def off(self) -> int:
        """Samples unaccounted for, above 0, or made up, below."""
        return max(0, self.least - self.counted) or min(0, self.most - self.counted)


def reckon(
    marks: Sequence[Mark], sessions: Sequence[Session], faults: Sequence[tuple[int, int]]
) -> list[Reckoning]:
    """A display's life, from one told end to the next, and from the last of them to its end.

    marks: what it said, in order. sessions: all that were while it lived, in order. faults: from
    and to when each was.
    """
    if not marks or not marks[-1].total:
        return []  # it never joined
    joined_ns = next(mark.now_ns for mark in marks if mark.total)
    found, base = [], 0
    least = most = 0
    for number, session in enumerate(sessions):
        following = sessions[number + 1].began_ns if number + 1 < len(sessions) else None
        told = _told(marks, session, following)
        if told is not None:
            found.append(Reckoning(told.total - base, least + session.least, most + session.most))
            base, least, most = told.total, 0, 0
        else:
            until_ns = min(session.ended_ns, marks[-1].now_ns)
            # What was over before it had joined anything it need not know of.
            if session.ended_ns > joined_ns:
                least += max(0, min(session.least, _surely_by(until_ns, session, faults)))
            most += min(session.most, _sent_by(marks[-1].now_ns, session))
    if most:
        found.append(Reckoning(marks[-1].total - base, least, most))
    return found


def _told(marks: Sequence[Mark], session: Session, following_ns: int | None) -> Mark | None:
    """The last mark at which the display knew that the session was over."""
    after = [
        mark
        for mark in marks
        if mark.state == "ended"
        and mark.now_ns >= session.ended_ns
        and (following_ns is None or mark.now_ns < following_ns)
    ]
    return after[-1] if after else None


def _sent_by(now_ns: int, session: Session) -> int:
    """How many samples a session can have at a time at most."""
    return (now_ns - session.began_ns) // session.period_ns + 1


def _surely_by(until_ns: int, session: Session, faults: Sequence[tuple[int, int]]) -> int:
    """How many samples had surely come to the display, and been told of, before trouble began."""
    for from_ns, to_ns in reversed(faults):
        if from_ns <= until_ns <= to_ns + AFTERMATH_NS:
            until_ns = from_ns
    return (until_ns - GRACE_NS - session.began_ns) // session.period_ns
