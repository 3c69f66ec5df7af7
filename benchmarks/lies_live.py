"""A few lies and stalls on real processes: the whole emulated bench, as people start it.

What `benchmarks/lies.py` and `benchmarks/random_stalls.py` show in virtual time, seen in the
emulated motor's own record.
"""

import signal
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.lies import LIMIT_N, TOUCH_N
from benchmarks.measure import show
from benchmarks.whole_bench import KINDS, BenchFailedError, MotorTrace, WholeBench, playing

# From the first press on: by then the pulse is felt.
BEGIN_S = "2"
AFTER_S = 2.5
FAULT_WITHIN_S = 8.0
TRIES = 3
STOPPED_S = (0.1, 0.4, 2.0)
LIES = (
    ("reversed",),
    ("reversed-encoder",),
    ("gain-encoder", "--size", "3"),
    ("no-retraction",),
    ("position-frozen",),
    ("delayed", "--size", "30 ms"),
    ("film-zero",),
    ("film-frozen",),
)


def main() -> None:
    """Print the table."""
    rows = [stopped_row(kind, seconds) for seconds in STOPPED_S for kind in KINDS]
    rows += [lied_row(kind, *lie) for lie in LIES for kind in KINDS]
    show(
        f"Stalls and lies on real processes; the limit is {LIMIT_N:g} N",
        ("what happens", "drive", "most N", "above ms", "off ms", "at the end N", "named"),
        rows,
    )


def stopped_row(kind: str, seconds: float) -> tuple[str, ...]:
    """The display's process is stopped for so long."""

    def happen(bench: WholeBench) -> int:
        display = bench.processes["display"]
        display.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        goes_on_ns = time.monotonic_ns()
        display.send_signal(signal.SIGCONT)
        time.sleep(AFTER_S)
        return goes_on_ns

    return _row(f"stopped for {seconds:g} s", kind, (), happen)


def lied_row(kind: str, *lie: str) -> tuple[str, ...]:
    """The emulated drive lies."""

    def happen(bench: WholeBench) -> None:
        try:
            bench.await_state("fault", FAULT_WITHIN_S)
        except BenchFailedError:
            return
        time.sleep(AFTER_S)

    return _row(" ".join(word for word in lie if word != "--size"), kind, lie, happen)


def _row(what: str, kind: str, lie: tuple[str, ...], happen) -> tuple[str, ...]:  # type: ignore[no-untyped-def]
    options = ("--fault", *lie, "--fault-after", BEGIN_S) if lie else ()
    for _ in range(TRIES):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            try:
                with playing(Path(folder), kind, "real_bench", *options) as bench:
                    at_ns = happen(bench)
                    last_ns = time.monotonic_ns()
                    faults = bench.end().get("faults", [])
                    return what, kind, *_figures(bench.motor(), at_ns, last_ns), "; ".join(faults)
            except BenchFailedError as error:
                why = str(error).splitlines()[0]
    return what, kind, "", "", "", "", why


def _figures(motor: MotorTrace, at_ns: int | None, last_ns: int) -> tuple[str, ...]:
    """Most force, time above the limit, time until off, and the force before it was ended."""
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
