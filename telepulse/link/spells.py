"""Bad spells that come and go: the two-state Markov chain of Gilbert and Elliott, in time."""

from bisect import bisect_right
from random import Random


class Spells:
    """Bad spells of exponential length, so that `share` of all time is bad.

    They depend on the seed and the time alone, not on what is sent: a link has the same weather
    for whoever uses it. Times may be asked for in any order.
    """

    def __init__(self, share: float, mean_ns: int, random: Random, start_ns: int) -> None:
        self._means_ns = (mean_ns * (1 - share) / share, mean_ns)
        self._random = random
        # Where good turns bad and bad turns good, by turns.
        self._edges_ns = [start_ns]
        self._extend()

    def end_ns(self, now_ns: int) -> int | None:
        """When the bad spell at `now_ns` ends; None outside of one."""
        while self._edges_ns[-1] <= now_ns:
            self._extend()
        position = bisect_right(self._edges_ns, now_ns)
        return self._edges_ns[position] if position % 2 == 0 and position else None

    def _extend(self) -> None:
        mean_ns = self._means_ns[(len(self._edges_ns) + 1) % 2]
        length_ns = max(1, round(self._random.expovariate(1 / mean_ns)))
        self._edges_ns.append(self._edges_ns[-1] + length_ns)
