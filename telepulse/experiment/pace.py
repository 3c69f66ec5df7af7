"""A loop that ticks as the clock on the wall does."""

import time
from collections.abc import Callable


def pace(tick_ns: int, tick: Callable[[int, int], bool]) -> None:
    """Call tick(due_ns, elapsed_ticks) when it is due, until it returns False.

    A tick that begins after the next one was due stands for both: elapsed_ticks says for how many.
    """
    next_ns = time.monotonic_ns() + tick_ns
    while True:
        now_ns = time.monotonic_ns()
        if now_ns < next_ns:
            time.sleep((next_ns - now_ns) * 1e-9)
            continue
        elapsed_ticks = 1 + (now_ns - next_ns) // tick_ns
        next_ns += elapsed_ticks * tick_ns
        if not tick(next_ns - tick_ns, elapsed_ticks):
            return
