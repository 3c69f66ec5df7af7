"""Felt forces that wait, in blocks, until the pulse around their instants is known. Pure."""

from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
# Most ticks of a block, so that judging it is short, and its greatest length, so that slow ticks
# are judged soon.
BLOCK: Final = 256
BLOCK_NS: Final = 256_000_000


class WaitingBlock(NamedTuple):
    """Consecutive ticks.

    times_ns: now, sensing clock and played instant of each, shape (3, n). last_now_ns,
    last_sensing_ns: the first two of the last tick.
    """

    times_ns: Times
    felt_n: Floats
    last_now_ns: int
    last_sensing_ns: int


class WaitingTicks:
    """Queue of blocks of ticks.

    newest_ns: time of the newest tick on the display's clock.
    """

    def __init__(self) -> None:
        self._whole = deque[WaitingBlock]()
        # The newest block, of which `_count` ticks are taken.
        self._times_ns, self._felt_n = np.empty((3, BLOCK), np.int64), np.empty(BLOCK)
        self._count = 0
        self.newest_ns = 0

    @property
    def oldest(self) -> WaitingBlock | None:
        """The oldest whole block; None without one."""
        return self._whole[0] if self._whole else None

    @property
    def first_instant_ns(self) -> int | None:
        """Instant that the first tick plays; None while none waits."""
        if self.oldest is not None:
            return int(self.oldest.times_ns[2, 0])
        return int(self._times_ns[2, 0]) if self._count else None

    def add(self, times_ns: Times, felt_n: Floats) -> None:
        """Add at least one tick, in the order of time; as in `WaitingBlock`."""
        now_ns, first = times_ns[0], 0
        while first < len(felt_n):
            end_ns = (self._times_ns[0, 0] if self._count else now_ns[first]) + BLOCK_NS
            most = first + BLOCK - self._count
            end = first + int(np.searchsorted(now_ns[first:most], end_ns))
            filled = slice(self._count, self._count + end - first)
            self._times_ns[:, filled] = times_ns[:, first:end]
            self._felt_n[filled] = felt_n[first:end]
            self._count, first = filled.stop, end
            if self._count == BLOCK or first < len(felt_n):
                self._close()
        self.newest_ns = int(now_ns[-1])

    def take(self) -> WaitingBlock:
        """Remove and return the oldest block, which may be the newest one; some tick must wait."""
        if not self._whole:
            self._close()
        return self._whole.popleft()

    def _close(self) -> None:
        times_ns, felt_n = self._times_ns[:, : self._count], self._felt_n[: self._count]
        last_now_ns, last_sensing_ns, _ = times_ns[:, -1].tolist()
        block = WaitingBlock(times_ns.copy(), felt_n.copy(), last_now_ns, last_sensing_ns)
        self._whole.append(block)
        self._count = 0
