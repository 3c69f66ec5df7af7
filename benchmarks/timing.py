"""Timing of calls."""

import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from protocol.histogram import bound
from protocol.summary.tables import Lateness, OneWayDelay, TickTime

REPEATS = 15
BATCH_S = 0.02


@dataclass(frozen=True, slots=True)
class Timing:
    """Cost of one call in µs: median, least and most of the repeats."""

    median_us: float
    least_us: float
    most_us: float


def time_call(call: Callable[[], object]) -> Timing:
    """Time `call` in batches of about 20 ms."""
    call()
    count = 1
    while (elapsed_s := _batch_s(call, count)) < BATCH_S:
        count = max(count + 1, round(count * min(10.0, 1.2 * BATCH_S / max(elapsed_s, 1e-9))))
    costs_us = [_batch_s(call, count) / count * 1e6 for _ in range(REPEATS)]
    return Timing(statistics.median(costs_us), min(costs_us), max(costs_us))


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


def _batch_s(call: Callable[[], object], count: int) -> float:
    began_s = time.perf_counter()
    for _ in range(count):
        call()
    return time.perf_counter() - began_s
