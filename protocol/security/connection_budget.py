"""Bounds on the connections that a node's doors hold open, and the choice of those cut beyond.

A stranger who connects again and again and says nothing must neither use up the process's file
descriptors, nor its memory, nor its loop's time; and those who came before him stay.
"""

from collections import Counter
from collections.abc import Sequence

from protocol.security.connection_table import ConnectionTable

# A door is shut while what happens at it cannot be read for so long; it is opened when all is read.
BEHIND_NS = 100_000_000
MAX_CUTS = 32


class ConnectionBudget:
    """Bounds the connections of several doors together. Time comes in.

    Of those that are no ZeroMQ connection yet, the oldest from the address that has most of them
    are cut; of the others, the newest from the address that has most. So one address alone never
    keeps the others out.

    Parameters
    ----------
    most
        How many connections may be open. Half of them may be pending, three quarters may come
        from one address.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._most_pending = most // 2
        self._most_from_one = most * 3 // 4
        self._behind_since_ns: dict[ConnectionTable, int] = {}

    def enforce(self, doors: Sequence[ConnectionTable], now_ns: int) -> list[str]:
        """Cut what is beyond the budget; return the address of each connection that was."""
        for door in doors:
            self._shut_or_open(door, now_ns)
        return [*self._cut_pending(doors), *self._cut_open(doors)]

    def _shut_or_open(self, door: ConnectionTable, now_ns: int) -> None:
        if not door.behind:
            self._behind_since_ns.pop(door, None)
            door.shut(False)
        elif now_ns - self._behind_since_ns.setdefault(door, now_ns) >= BEHIND_NS:
            door.shut(True)

    def _cut_pending(self, doors: Sequence[ConnectionTable]) -> list[str]:
        if sum(door.most_pending for door in doors) <= self._most_pending:
            return []
        pending = [(*one, door) for door in doors for one in door.pending()]
        beyond = len(pending) - self._most_pending
        if beyond <= 0:
            return []
        (most_of, _), *_ = Counter(address for _, _, address, _ in pending).most_common(1)
        oldest = sorted((one for one in pending if one[2] == most_of), key=lambda one: one[0])
        oldest = oldest[: min(beyond, MAX_CUTS)]
        for _, number, _, door in oldest:
            door.cut_one(number)
        return [most_of] * len(oldest)

    def _cut_open(self, doors: Sequence[ConnectionTable]) -> list[str]:
        total = sum(door.connections for door in doors)
        if total <= self._most_from_one:
            return []
        by_address = sum((door.by_address for door in doors), Counter[str]())
        (most_of, count), *_ = by_address.most_common(1)
        beyond = min(max(total - self.most, count - self._most_from_one), MAX_CUTS)
        cut: list[str] = []
        for door in sorted(doors, key=lambda door: -door.by_address[most_of]):
            for number in door.newest_from(most_of, beyond - len(cut)):
                door.cut_one(number)
                cut.append(most_of)
        return cut
