"""Times without the pulse: after each fault, and at displays that were not disturbed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from soak.faults import Done
from soak.felt import FeltLog, felt_again_ns, longest_gap_ns
from soak.schedule import CONTINUOUS, RESTARTED, TEMPORARY

ALWAYS_THERE = (CONTINUOUS, RESTARTED)


@dataclass(frozen=True, slots=True)
class Played:
    """An episode as it was made, with the rest after it."""

    done: tuple[Done, ...]
    began_ns: int
    until_ns: int

    def over_ns(self, role: str) -> int | None:
        """Return the end of the last fault of a display; None without one."""
        return max((done.over_ns for done in self.done if role in done.displays), default=None)

    def kind(self, role: str) -> str:
        """Return the kinds of the faults made on the display."""
        return " + ".join(sorted({x.fault.kind for x in self.done if role in x.displays}))


def recoveries(
    episodes: Sequence[Played], felt: Mapping[str, FeltLog]
) -> dict[str, list[float | None]]:
    """Return, by kind of fault, the times in s from its end until the pulse was felt again.

    None if it was not felt before the next fault.
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
        # With a second fault, a temporary display need not have felt anything before it left.
        if len(played.done) == 1 and played.done[0].fault.kind == "temporary display":
            (done,) = played.done
            add(
                "temporary display",
                TEMPORARY,
                done.over_ns,
                done.over_ns + round(done.fault.for_s * 1e9),
            )
    return table


def undisturbed_gaps_s(episodes: Sequence[Played], felt: Mapping[str, FeltLog]) -> list[float]:
    """Return the longest times in s without the pulse at displays that were not disturbed.

    There is one for each display and episode.
    """
    return [
        gap_s
        for role in ALWAYS_THERE
        for gap_s in gaps_s([x for x in episodes if x.over_ns(role) is None], felt[role])
    ]


def gaps_s(episodes: Sequence[Played], felt: FeltLog) -> list[float]:
    """Return the longest time without the pulse in each of these episodes."""
    return [longest_gap_ns(felt.spells, x.began_ns, x.until_ns) * 1e-9 for x in episodes]
