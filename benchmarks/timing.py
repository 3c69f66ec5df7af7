"""Timing of calls, and processes that are timed."""

import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from protocol.histogram import bound
from protocol.summary.fields import Lateness, OneWayDelay, TickTime

REPEATS = 15
BATCH_S = 0.02
spawn = get_context("spawn")


@contextmanager
def process(target: Callable[..., None], *arguments: Any) -> Iterator[BaseProcess]:
    """Run `target` in a process until the block ends."""
    child = spawn.Process(target=target, args=arguments, daemon=True)
    child.start()
    try:
        yield child
    finally:
        child.terminate()
        child.join()


def time_call(call: Callable[[], object]) -> float:
    """Return the median cost of a call in µs, in batches of about 20 ms."""
    call()
    count = 1
    while (elapsed_s := _batch_s(call, count)) < BATCH_S:
        count = max(count + 1, round(count * min(10.0, 1.2 * BATCH_S / max(elapsed_s, 1e-9))))
    return statistics.median(_batch_s(call, count) / count * 1e6 for _ in range(REPEATS))


def paced(period_ns: int) -> Iterator[int]:
    """Yield the times at which periods end, each when it is due."""
    due_ns = time.perf_counter_ns()
    while True:
        due_ns += period_ns
        time.sleep(max(0, due_ns - time.perf_counter_ns()) * 1e-9)
        yield due_ns


def median_quantile(
    key: str, tables: Iterable[OneWayDelay | TickTime | Lateness], digits: int = 0
) -> str:
    """Return the median of a quantile over runs; "> 5000" beyond the range that is counted."""
    found = [
        (figure, key in table.beyond)
        for table in tables
        if (figure := getattr(table, key)) is not None
    ]
    if not found:
        return "–"
    figure, beyond = statistics.median_low(found)
    return f"{bound(key, [key] if beyond else [])}{figure:.{digits}f}"


def thread_times_s(pid: int) -> tuple[float, float]:
    """Return the CPU time in s of a process's main thread so far, and of all its other threads."""
    main_s = rest_s = 0.0
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):  # it has ended
            ran_s = int((thread / "schedstat").read_text(encoding="ascii").split()[0]) * 1e-9
            if thread.name == str(pid):
                main_s += ran_s
            else:
                rest_s += ran_s
    return main_s, rest_s


def _batch_s(call: Callable[[], object], count: int) -> float:
    began_s = time.perf_counter()
    for _ in range(count):
        call()
    return time.perf_counter() - began_s
