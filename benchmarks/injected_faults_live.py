"""Stalls of the display on real processes: the whole emulated bench, as people start it.

The results of `benchmarks/random_stalls.py`, which is in virtual time, checked against the emulated
motor's own record.
"""

import signal
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.benchmark import Benchmark
from tests.support.emulated_bench import BenchFailedError, EmulatedBench, MotorTrace, playing
from tests.support.fault_runs import KINDS, LIMIT_N, TOUCH_N

AFTER_S = 2.5
TRIES = 3
STOPPED_S = (0.1, 0.4, 2.0)


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    rows = [stopped_row(kind, seconds) for seconds in STOPPED_S for kind in KINDS]
    benchmark.table(
        f"Stalls on real processes; the limit is {LIMIT_N:g} N",
        ("what happens", "drive", "most N", "above ms", "off ms", "at the end N", "named"),
        rows,
    )


def stopped_row(kind: str, seconds: float) -> tuple[str, ...]:
    """Stop the display's process for `seconds`, and return the table's row."""

    def stop(bench: EmulatedBench) -> int:
        display = bench.processes["display"]
        display.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        continued_ns = time.perf_counter_ns()
        display.send_signal(signal.SIGCONT)
        time.sleep(AFTER_S)
        return continued_ns

    return _row(f"stopped for {seconds:g} s", kind, stop)


def _row(
    what: str,
    kind: str,
    act: Callable[[EmulatedBench], int | None],
) -> tuple[str, ...]:
    for _ in range(TRIES):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            try:
                with playing(Path(folder), kind, "real_bench") as bench:
                    at_ns = act(bench)
                    last_ns = time.perf_counter_ns()
                    faults = bench.end().get("faults", [])
                    return what, kind, *_figures(bench.motor(), at_ns, last_ns), "; ".join(faults)
            except BenchFailedError as error:
                why = str(error).splitlines()[0]
    return what, kind, "", "", "", "", why


def _figures(motor: MotorTrace, at_ns: int | None, last_ns: int) -> tuple[str, ...]:
    """Return the greatest force, the time above the limit and until off, and the last force."""
    at_ns = at_ns or motor.trouble_ns or 0
    seen = motor.time_ns < last_ns
    pressing_ns = motor.time_ns[seen & (motor.force_n > TOUCH_N)].max(initial=at_ns)
    end_n = float(motor.force_n[seen][-1])
    return (
        f"{motor.force_n.max():.2f}",
        str(int(np.sum(motor.force_n > LIMIT_N))),
        f"{(pressing_ns - at_ns) / 1e6:.0f}" if end_n < TOUCH_N else "stays on",
        f"{end_n:.3f}",
    )
