"""Cost of a recorder, and of a long file as a source.

Its cases: "recorder", "long files".
"""

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from subprocess import PIPE

import numpy as np
import zmq
from numpy.typing import NDArray

from benchmarks.benchmark import Benchmark
from benchmarks.timing import paced
from display_node.telemetry.publisher import Publisher
from protocol import sockets
from protocol.host.child_process import ChildProcess
from protocol.summary.fields import Summary
from protocol.ticks import TickBlock, TickState
from protocol.wire.messages import Frame, encode_frame
from protocol.wire.telemetry import pack_status

TICK_NS = 1_000_000
TICKS_A_FRAME = 5
# As of a display: a trace every 100 ms.
TRACE_TICKS = 100
TICKS = 20_000
START_S = 30.0
Reader = Callable[[str], AbstractContextManager[bool]]
END = pack_status("ended", "", Summary(), final=True)


def main(benchmark: Benchmark) -> None:
    """Print the tables of the chosen cases."""
    benchmark.run_parts({"recorder": recorder_cost, "long files": long_files})


def recorder_cost(benchmark: Benchmark) -> None:
    """Print what a recorder costs for each of the display's ticks and for itself."""
    rows = []
    for name, reader in (("nobody reads", nobody), ("a screen reads", screen)):
        cost_us, _ = measure(reader, TICKS)
        rows.append((name, *summed_up(cost_us)))
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder:
        empty, full = Path(folder, "empty.mcap"), Path(folder, "full.mcap")
        _, start_s = measure(lambda address: recorder(address, empty), ticks=0)
        cost_us, work_s = measure(lambda address: recorder(address, full), TICKS)
        size_bytes = full.stat().st_size
    rows.append(("a recorder reads", *summed_up(cost_us)))
    columns = ("telemetry of a tick", "mean µs", "p50 µs", "p50 of every 20th, µs", "p99 µs")
    benchmark.table("Time that the real-time loop spends on its telemetry", columns, rows)
    long_s = TICKS * TICK_NS * 1e-9
    share, hourly = (work_s - start_s) / long_s, size_bytes / long_s * 3600e-6
    print(f"The recorder: {share:.1%} of a core once it has started, {hourly:.0f} MB an hour")


def measure(reader: Reader, ticks: int) -> tuple[NDArray[np.float64], float]:
    """Return each tick's telemetry in µs, and the reader's CPU time in s."""
    context: sockets.Context = zmq.Context()
    publisher = Publisher(sockets.bind(context, zmq.XPUB, "tcp://127.0.0.1:*"), run=1)
    before_s = sum(os.times()[2:4])
    with reader(publisher.address) as records:
        if records and not publisher.await_recorder(START_S):
            raise SystemExit("benchmarks: the recorder does not start")
        cost_us = publish(publisher, ticks)
        publisher.finish(END)
    context.destroy(linger=500)
    return cost_us, sum(os.times()[2:4]) - before_s


def publish(publisher: Publisher, ticks: int) -> NDArray[np.float64]:
    """Run ticks of a millisecond; return the time that the telemetry of each took, in µs."""
    chance = np.random.default_rng(1)
    force_n = 0.4 + 0.1 * np.sin(np.arange(TICKS) * 0.008) + 1e-3 * chance.standard_normal(TICKS)
    status = pack_status("playing", "pulse", Summary(), final=False)
    cost_us, block = np.empty(ticks), TickBlock(1, TRACE_TICKS)
    for tick, due_ns in zip(range(ticks), paced(TICK_NS), strict=False):
        values = force_n[tick : tick + TICKS_A_FRAME, np.newaxis].astype("<f4")
        data = encode_frame(Frame(1, tick, due_ns, TICK_NS, values))
        felt = TickState(
            due_ns, due_ns, due_ns, force_n[tick], force_n[tick] * 1.001, True, math.nan
        )
        began_ns = time.perf_counter_ns()
        if tick % TICKS_A_FRAME == 0:
            publisher.captured.add(due_ns, 0, data)
        block.add([felt])
        if block.count == block.most:
            publisher.trace.add(block)
            block.count = 0
            if publisher.publish():
                publisher.status(status)
        cost_us[tick] = (time.perf_counter_ns() - began_ns) * 1e-3
    return cost_us


def summed_up(cost_us: NDArray[np.float64]) -> list[str]:
    """Return the mean; medians of all ticks and of those that publish a trace; 99th percentile."""
    publishing = np.median(cost_us[TRACE_TICKS - 1 :: TRACE_TICKS])
    figures = (cost_us.mean(), np.median(cost_us), publishing, np.quantile(cost_us, 0.99))
    return [f"{figure:.1f}" for figure in figures]


@contextmanager
def nobody(address: str) -> Iterator[bool]:
    """Provide no reader."""
    yield False


@contextmanager
def screen(address: str) -> Iterator[bool]:
    """Provide a reader of traces and statuses, in a process of its own."""
    code = "import sys; from display_node.telemetry.terminal import watch;"
    code += " from rich.console import Console;"
    code += " watch(sys.argv[1], Console(), draw=False)"
    with ChildProcess("screen", "-c", code, address) as process:
        time.sleep(2)
        yield False
        process.wait()


@contextmanager
def recorder(address: str, path: Path) -> Iterator[bool]:
    """Provide the recorder."""
    command = ("-m", "telepulse", "record", address, str(path), "--quiet")
    with ChildProcess("recorder", *command) as process:
        yield True
        process.wait()


DAY_S, HOUR_S, RATE_HZ = 86_400, 3_600, 1_000
# Samples that are written at once: whole beats of 0.8 s.
PART = 800_000
FIRST_SAMPLE = """
import sys
from pathlib import Path
from sensing_node.files.signal_choice import record_table
from sensing_node.sources.recorded import RecordedSource, RecordingScene
table, _ = record_table(Path(sys.argv[1]))
RecordedSource(RecordingScene.model_validate(table | {"rate": "1 kHz"}), Path()).take(1)
# Of this program alone: ru_maxrss has that of the one which started it, too.
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
"""


def long_files(benchmark: Benchmark) -> None:
    """Print time and memory until the first sample of a long file can be played."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder:
        for name, kind, seconds in (
            ("a day, .npy of 32-bit floats", "<f4", DAY_S),
            ("a day, .npy of 16-bit integers", "<i2", DAY_S),
            ("an hour, .csv with times", "", HOUR_S),
        ):
            path = Path(folder, "pulse.npy" if kind else "pulse.csv")
            write(path, kind, seconds * RATE_HZ)
            start_s, most_mb = first_sample(path)
            size_mb = path.stat().st_size * 1e-6
            rows.append((name, f"{size_mb:.0f}", f"{start_s:.1f}", f"{most_mb:.0f}"))
    columns = ("file at 1 kHz", "size, MB", "until the first sample, s", "most memory, MB")
    benchmark.table("A long file as a source", columns, rows)


def write(path: Path, kind: str, samples: int) -> None:
    """Write a pulse of 75 beats a minute as an array of a kind of numbers, or as text."""
    beat_s = np.arange(PART) / RATE_HZ % 0.8
    pulse = 1000 * np.exp(-(((beat_s - 0.3) / 0.08) ** 2))
    if kind:
        array = np.lib.format.open_memmap(path, "w+", kind, (samples,))
        for first in range(0, samples, PART):
            array[first : first + PART] = pulse[: samples - first]
        return
    with path.open("w", encoding="ascii") as file:
        file.write("t [s],force [mN]\n")
        for at in range(samples):
            file.write(f"{at / RATE_HZ:.3f},{pulse[at % PART]:.2f}\n")


def first_sample(path: Path) -> tuple[float, float]:
    """Play the first sample in a process; return its whole time in s and its peak memory in MB."""
    began_s = time.perf_counter()
    with ChildProcess("player", "-c", FIRST_SAMPLE, str(path), stdout=PIPE) as process:
        printed, _ = process.communicate()
    if process.returncode:
        raise SystemExit(f"benchmarks: {path} cannot be played")
    return time.perf_counter() - began_s, int(printed) * 1e-3
