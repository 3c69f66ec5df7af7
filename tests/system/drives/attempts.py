"""A bench of processes that is started again where a busy machine has stopped it."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

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
