"""How late ticks begin: the loop's own wait at a scene's tick, with measures and without."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

from protocol import sockets
from protocol.histogram import Histogram
from protocol.host.child_process import ChildProcess
from protocol.host.realtime import Pacer, RealtimeRequest, hold

# It ends with who started it, however that ends.
BUSY = """
import os, sys
while os.getppid() == int(sys.argv[1]):
    pass
"""

Work = Callable[[int, int], object]


@dataclass(slots=True)
class Ticks:
    """late_us: how late ticks began; missed: those that did not begin within their period."""

    late_us: Histogram = field(default_factory=lambda: Histogram(2.0, 5_000))
    missed: int = 0

    @property
    def due(self) -> int:
        """How many ticks there should have been."""
        return self.late_us.count + self.missed


def run_ticks(
    ticks: Ticks, tick_ns: int, seconds: float, descriptors: Sequence[int], work: Work
) -> None:
    """Wait for ticks as a display does, and call `work` in each.

    work: takes the time in ns at which the tick was due, and the number of ticks since the last.
    """
    pacer = Pacer(tick_ns, time.monotonic_ns())
    end_ns = pacer.due_ns + round(seconds * 1e9)
    # Until nothing is due any more: a wait that ends after the end is the latest of all.
    while pacer.due_ns <= end_ns:
        now_ns = time.monotonic_ns()
        tick = pacer.begin(now_ns)
        if tick is None:
            sockets.wait_drained(descriptors, pacer.due_ns - now_ns)
            continue
        ticks.late_us.add(tick.late_ns * 1e-3)
        work(tick.due_ns, tick.elapsed_ticks)
    ticks.missed += pacer.missed


def run_in_turns(
    wishes: dict[str, RealtimeRequest],
    rounds: int,
    slot_s: float,
    tick_ns: int,
    descriptors: Sequence[int],
    work: Work,
) -> dict[str, Ticks]:
    """Ticks with each of the wishes held, by turns, so that all of them meet the same host."""
    found = {name: Ticks() for name in wishes}
    for _ in range(rounds):
        for name, asked in wishes.items():
            with hold(asked):
                run_ticks(found[name], tick_ns, slot_s, descriptors, work)
    return found


@contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """As many processes that compute without a pause."""
    with ExitStack() as stack:
        for _ in range(count):
            arguments = ("-S", "-c", BUSY, str(os.getpid()))
            stack.enter_context(ChildProcess("busy process", *arguments))
        yield
