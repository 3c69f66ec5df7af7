"""Errors of clock offset and skew over an emulated link, beside LSL's.

It needs root, for the link emulator, and pylsl. It takes four minutes.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from subprocess import PIPE

import numpy as np

from benchmarks.benchmark import Benchmark
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
LSL = "LSL, 0 ppm"


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
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
        ("clock", "after", "median", "worst", "stated", "within", "ppm"),
        rows,
    )
    ours = [name for name in runs[0] if name != LSL]
    for mark_s in (5.0, 60.0):
        errors = np.vstack([near(each[name], mark_s) for each in runs for name in ours])
        most_s = 1e-3 * float(np.abs(errors[:, 1]).max())
        benchmark.judge(f"error of the offset after {mark_s:g} s", most_s)
    benchmark.judge("error of the skew after 60 s", 1e-6 * float(np.abs(errors[:, 3]).max()))
    judge_against_lsl(benchmark, runs)


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
    else:
        cells += [""] * 3
    return (name, f"{mark_s:g} s", *cells)


def judge_against_lsl(benchmark: Benchmark, runs: list[dict[str, Floats]]) -> None:
    """Judge our worst clock's RMS error over LSL's, from 5 s to the end."""
    rms = {}
    for name in runs[0]:
        table = np.vstack([each[name] for each in runs])
        rms[name] = float(np.sqrt(np.mean(table[table[:, 0] >= 5.0, 1] ** 2)))
    ours = max(value for name, value in rms.items() if name != LSL)
    rows = [(name, f"{value:.3f} ms") for name, value in rms.items()]
    benchmark.table("RMS error of the offset from 5 s on", ("clock", "error"), rows)
    benchmark.judge("RMS error over LSL's at 0 ppm, its easiest", ours / rms[LSL])
