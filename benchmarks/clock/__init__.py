"""Errors of clock offset and skew, in virtual time and over an emulated link, beside LSL's.

The second part needs root, for the link emulator, and pylsl. It takes four minutes.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from subprocess import PIPE

import numpy as np

from benchmarks.benchmark import Benchmark
from benchmarks.clock import virtual
from protocol.clock.one_way import Floats
from protocol.host.child_process import ChildProcess
from telepulse.simulation.link_scene import parse_link
from tests.support.netem import Namespace, emulate, unavailable

LINK = "delay=20ms,jitter=3ms,loss=1%"
SECONDS = 62.0
RUNS = 3
SKEWS_PPM = (-200.0, 0.0, 200.0)
PORT = 5555
STARTUP_S = 60.0
MARKS_S = (5.0, 10.0, 30.0, 60.0)
BARS = {5.0: "1 ms", 60.0: "0.3 ms, 5 ppm"}
LSL = "LSL, 0 ppm"


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    virtual.main(benchmark)
    reason = unavailable()
    if reason is not None:
        print(f"clock over the emulator: left out: {reason}")
        return
    runs = [run(seed) for seed in range(1, RUNS + 1)]
    rows = [
        row(name, mark_s, [each[name] for each in runs]) for name in runs[0] for mark_s in MARKS_S
    ]
    benchmark.table(
        f"Clock at 20±3 ms, 1 % loss, over real TCP: offset error in the second before each time,"
        f" {RUNS} runs, all clocks at once; ppm: worst error of the skew",
        ("clock", "after", "median", "worst", "stated", "within", "ppm", "bar"),
        rows,
    )
    print(against_lsl(runs))


def run(seed: int) -> dict[str, Floats]:
    """Return the lines of each listener: one of each skew of ours, and of LSL."""
    origin_ns = time.perf_counter_ns()
    with ExitStack() as stack:
        link = stack.enter_context(emulate(parse_link(LINK), seed=seed))
        listeners = {}
        seconds = str(SECONDS + STARTUP_S)
        for number, skew_ppm in enumerate(SKEWS_PPM):
            address = f"tcp://{link.sensing.address}:{PORT + 10 * number}"
            common = (address, str(skew_ppm), str(origin_ns))
            stack.enter_context(started(link.sensing, "sense", *common, seconds))
            listeners[f"ours, {skew_ppm:+g} ppm"] = stack.enter_context(
                started(link.display, "follow", *common, str(SECONDS))
            )
        stack.enter_context(started(link.sensing, "lsl_outlet", link.display.address, seconds))
        listeners[LSL] = stack.enter_context(
            started(link.display, "lsl_inlet", link.sensing.address, str(SECONDS))
        )
        return {name: figures(process) for name, process in listeners.items()}


@contextmanager
def started(namespace: Namespace, *command: str) -> Iterator[ChildProcess]:
    """Run one of `benchmarks.clock.ends` in a namespace."""
    with namespace.entered():
        process = ChildProcess("end", "-m", "benchmarks.clock.ends", *command, stdout=PIPE)
    with process:
        yield process


def figures(process: ChildProcess) -> Floats:
    """Return the printed lines of a listener."""
    lines = process.communicate(timeout=SECONDS + STARTUP_S)[0].splitlines()
    table: Floats = np.array([[float(word) for word in line.split()] for line in lines])
    return table


def near(table: Floats, mark_s: float) -> Floats:
    """Return the rows of the second before a time."""
    rows: Floats = table[(table[:, 0] > mark_s - 1) & (table[:, 0] <= mark_s)]
    return rows


def row(name: str, mark_s: float, tables: list[Floats]) -> tuple[str, ...]:
    """Return the table's row of one clock at one time."""
    rows = np.vstack([near(table, mark_s) for table in tables])
    error_ms = np.abs(rows[:, 1])
    cells = [f"{np.median(error_ms):.3f} ms", f"{error_ms.max():.3f} ms"]
    if rows.shape[1] > 2:
        stated_ms = rows[:, 2]
        within = np.mean(error_ms <= stated_ms)
        worst_ppm = np.abs(rows[:, 3]).max()
        cells += [f"±{np.median(stated_ms):.2f} ms", f"{within:.0%}", f"{worst_ppm:.1f}"]
        cells.append(BARS.get(mark_s, ""))
    else:
        cells += [""] * 4
    return (name, f"{mark_s:g} s", *cells)


def against_lsl(runs: list[dict[str, Floats]]) -> str:
    """Return our worst clock's RMS error over LSL's, from 5 s to the end."""
    rms = {
        name: float(np.sqrt(np.mean(np.concatenate([after_5_s(r[name]) for r in runs]) ** 2)))
        for name in runs[0]
    }
    ours = max(value for name, value in rms.items() if name != LSL)
    listed = ", ".join(f"{name}: {value:.3f} ms" for name, value in rms.items())
    return (
        f"RMS error from 5 s on: {listed}\nour worst over LSL's at 0 ppm, its easiest: "
        f"{ours / rms[LSL]:.2f} (bar: 0.33)"
    )


def after_5_s(table: Floats) -> Floats:
    """Return the errors in ms from 5 s on."""
    errors_ms: Floats = table[table[:, 0] >= 5.0, 1]
    return errors_ms
