"""Pacing of a loop that ticks at a fixed period. Pure: the time comes in, the caller waits."""

from typing import NamedTuple


class PacedTick(NamedTuple):
    """A tick that begins.

    due_ns: when it was due; late_ns: how much later it begins; elapsed_ticks: periods since the
    last tick, 1 where none was missed.
    """

    due_ns: int
    late_ns: int
    elapsed_ticks: int


class Pacer:
    """Decides when a tick begins, and how many it stands for.

    A tick that begins after the next one was due stands for both. Ticks stay on the grid of the
    first one, however late each begins.

    Parameters
    ----------
    tick_ns
        Period in ns.
    now_ns
        Present time in ns; the first tick is due a period later.

    Attributes
    ----------
    due_ns
        When the next tick is due, in ns.
    missed
        Ticks that did not begin within their period.
    """

    def __init__(self, tick_ns: int, now_ns: int) -> None:
        self._tick_ns = tick_ns
        self.due_ns = now_ns + tick_ns
        self.missed = 0

    def begin(self, now_ns: int) -> PacedTick | None:
        """Begin the tick that is due at `now_ns`; return None while none is."""
        late_ns = now_ns - self.due_ns
        if late_ns < 0:
            return None
        elapsed_ticks = 1 + late_ns // self._tick_ns
        self.missed += elapsed_ticks - 1
        self.due_ns += elapsed_ticks * self._tick_ns
        # As of when it was due: speeds commanded then add up to the distance, however late it is.
        return PacedTick(self.due_ns - self._tick_ns, late_ns, elapsed_ticks)
