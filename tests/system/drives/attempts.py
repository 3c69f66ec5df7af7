"""A bench of processes that is started again where a busy machine has stopped it."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from protocol.errors import DriveError
from tests.support.drive_benches import Bench, real_bench
from tests.support.emulated_bench import BenchFailedError, EmulatedBench

TRIES = 4
# Watchdog for a machine that is busy with other tests; benchmarks/bench_faults.py has the scenes'.
PATIENCE_MS = 400


def on_bench(
    folder: Path,
    playing: Callable[[Path], AbstractContextManager[EmulatedBench]],
    happens: Callable[[EmulatedBench], None],
) -> EmulatedBench:
    """Return a bench, ended, on which `happens` was called while the pulse was felt."""
    for attempt in range(TRIES):
        (here := folder / str(attempt)).mkdir()
        try:
            with playing(here) as bench:
                happens(bench)
                bench.end()
                return bench
        except BenchFailedError as error:
            why = str(error)
    pytest.fail(f"the pulse was not felt in {TRIES} attempts: {why}")


@contextmanager
def started(kind: str, rate_hz: float = 0.0) -> Iterator[Bench]:
    """Start a drive on a real line, again where the machine was too busy for its supervision."""
    for attempt in range(TRIES):
        with real_bench(kind) as bench:
            try:
                bench.start(rate_hz)
            except DriveError:
                if attempt == TRIES - 1:
                    raise
                continue
            yield bench
            return
