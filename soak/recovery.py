"""After each episode: when the pulse was felt again, and by whom it was felt all the time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from soak.faults import Done
from soak.felt import FeltLog, felt_again_ns, longest_gap_ns
from soak.schedule import ENDURING, GUEST, MORTAL

ALWAYS_THERE = (ENDURING, MORTAL)


@dataclass(frozen=True, slots=True)
class Played:
    """An episode as it was, with the calm after it."""

    done: tuple[Done, ...]
    began_ns: int
    until_ns: int

    def over_ns(self, role: str) -> int | None:
        """When the last fault that was done to a display was over; None when none was."""
        return max((done.over_ns for done in self.done if role in done.displays), default=None)

    def kind(self, role: str) -> str:
        """The kinds of the faults that were done to a display."""
        return " + ".join(sorted({x.fault.kind for x in self.done if role in x.displays}))


def recoveries(
    episodes: Sequence[Played], felt: Mapping[str, FeltLog]
) -> dict[str, list[float | None]]:
    """By kind of fault, how many seconds after each one's end its displays felt the pulse again;
    None where they did not before the next fault.
    """
    table: dict[str, list[float | None]] = {}

    def add(kind: str, role: str, over_ns: int, until_ns: int) -> None:
        again_ns = felt_again_ns(felt[role].spells, over_ns, until_ns)
        table.setdefault(kind, []).append(None if again_ns is None else again_ns * 1e-9)

    for played in episodes:
        for role in ALWAYS_THERE:
            over_ns = played.over_ns(role)
            if over_ns is not None:
                add(played.kind(role), role, over_ns, played.until_ns)
        # With another fault beside it, a guest need not have felt anything before it left.
        if len(played.done) == 1 and played.done[0].fault.kind == "guest":
            (done,) = played.done
            add("guest", GUEST, done.over_ns, done.over_ns + round(done.fault.for_s * 1e9))
    return table


def beside(episodes: Sequence[Played], felt: Mapping[str, FeltLog]) -> list[float]:
    """The longest time in s without the pulse, of each display in each episode in which nothing
    was done to it.
    """
    return [
        gap_s
        for role in ALWAYS_THERE
        for gap_s in gaps_s([x for x in episodes if x.over_ns(role) is None], felt[role])
    ]


def gaps_s(episodes: Sequence[Played], felt: FeltLog) -> list[float]:
    """The longest time without the pulse in each of these episodes."""
    return [longest_gap_ns(felt.spells, x.began_ns, x.until_ns) * 1e-9 for x in episodes]
