"""Cost of a recorder: for each of the display's ticks, for itself, and the size of its file."""

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import zmq
from numpy.typing import NDArray

from benchmarks.benchmark import Benchmark
from benchmarks.timing import paced
from display_node.telemetry.publisher import Publisher
from protocol import sockets
from protocol.host.child_process import ChildProcess
from protocol.summary.tables import Summary
from protocol.ticks import TickState
from protocol.wire.messages import Frame, encode_frame
from protocol.wire.telemetry import TRACE_TICKS, pack_status

TICK_NS = 1_000_000
TICKS_A_FRAME = 5
TICKS = 20_000
START_S = 30.0
Reader = Callable[[str], AbstractContextManager[bool]]
END = pack_status("ended", "", Summary(), final=True)


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
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
    cost_us = np.empty(ticks)
    for tick, due_ns in zip(range(ticks), paced(TICK_NS), strict=False):
        values = force_n[tick : tick + TICKS_A_FRAME, np.newaxis].astype("<f4")
        data = encode_frame(Frame(1, tick, due_ns, TICK_NS, values))
        felt = TickState(
            due_ns, due_ns, due_ns, force_n[tick], force_n[tick] * 1.001, True, math.nan
        )
        began_ns = time.perf_counter_ns()
        if tick % TICKS_A_FRAME == 0:
            publisher.captured.add(due_ns, 0, data)
        if publisher.add(felt) and publisher.publish():
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
