"""Real drives: cost of a velocity command, and rate of commands on a serial line.

The emulated drives answer from a thread of this process. A virtual bus has no arbitration and no
bit rate, and a pseudo-terminal no baud rate: real ones add their own times.
"""

import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import can
import numpy as np

from benchmarks.benchmark import Benchmark
from pulse_drives.axis import build_axis
from pulse_drives.cia402.drive import Cia402Drive
from pulse_drives.cia402.node import Cia402Node
from pulse_drives.cia402.state_machine import Controlword, Mode
from pulse_drives.drive import Drive
from pulse_drives.scene import TMCL_BITS
from tests.support.drive_benches import FORCE_LIMIT_N, LAYER, cia402_scene, real_bench, stepper

RUNS = 5
CALLS = 500
BAUDS = (9_600, 57_600, 115_200, 500_000, 1_000_000)
# Without homing, and with first touch at the present position, the drive starts at once.
HERE = {"homing": "none", "touch": "0 m", "watchdog": "1 s"}
# One step per second.
SLOW_M_PER_S = stepper().step_m

Call = Callable[[], object]


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    with ExitStack() as open_things:
        calls = open_things.enter_context(pdos_to_nobody())
        for kind, where in (("cia402", "virtual CAN"), ("cia402-slcan", "slcan")):
            drive = open_things.enter_context(real_bench(kind, **HERE)).drive
            calls[f"CiA 402 command (PDO, SYNC, heartbeat), {where}"] = Commands(drive)
            calls[f"CiA 402 SDO write and its answer, {where}"] = acceleration_of(drive)
        drive = open_things.enter_context(real_bench("tmcl", **HERE)).drive
        calls["TMCL drive: command (mailbox)"] = Commands(drive)
        # Interleaved, so that a busy moment of the machine affects all equally.
        count = 1 if benchmark.quick else RUNS
        runs = [{name: percentiles(call) for name, call in calls.items()} for _ in range(count)]
    pdo_us = statistics.median(run["PDO"][1] for run in runs)
    benchmark.judge("PDO of a velocity command, 99th percentile", pdo_us * 1e-6)
    benchmark.table(
        f"One velocity command in µs, median of {count} interleaved runs of {CALLS}. CPU: of the"
        " calling thread only",
        ("what", "p50", "p99", "CPU p50", "CPU p99"),
        [
            (name, *(f"{us:.0f}" for us in np.median([run[name] for run in runs], axis=0)))
            for name in calls
        ],
    )
    benchmark.table(
        "Commands to a TMCL module on a serial line: request and reply are 9 bytes each",
        ("baud", "request and reply, ms", "commands a second, at most"),
        [
            (str(baud), f"{2e3 * TMCL_BITS / baud:.2f}", f"{baud / (2 * TMCL_BITS):.0f}")
            for baud in BAUDS
        ],
    )


def percentiles(call: Call) -> tuple[float, ...]:
    """Return p50 and p99 of single calls in µs: of elapsed time, then of the caller's CPU time."""
    if isinstance(call, Commands):
        call.prepare()
    costs_ns = np.empty((CALLS, 2))
    for number in range(CALLS):
        began_ns, cpu_ns = time.perf_counter_ns(), time.thread_time_ns()
        call()
        costs_ns[number] = time.perf_counter_ns() - began_ns, time.thread_time_ns() - cpu_ns
    quantiles = np.quantile(costs_ns, (0.5, 0.99), axis=0) * 1e-3
    return tuple(quantiles.T.ravel().tolist())


@contextmanager
def pdos_to_nobody() -> Iterator[dict[str, Call]]:
    """Provide the cost of sending alone: no thread reads the other end of the bus."""
    bus = {"interface": "virtual", "channel": "nobody"}
    scene, actuator = cia402_scene(**bus), stepper()
    axis = build_axis(scene, actuator, actuator.deepest_m(LAYER, FORCE_LIMIT_N))
    node = Cia402Node(scene, axis, Counter())
    frame = can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(6))
    with can.Bus(**bus), can.Bus(**bus) as bare:  # type: ignore[arg-type]

        def tell(cyclic: bool) -> None:
            node.mode = Mode.CYCLIC_VELOCITY if cyclic else Mode.PROFILE_VELOCITY
            node.command(Controlword.ENABLE, 1_000)

        yield {
            "PDO by python-can alone": lambda: bare.send(frame),
            "PDO": lambda: tell(False),
            "PDO and SYNC": lambda: tell(True),
        }
        node.close()


class Commands:
    """Commands to a drive."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive

    def prepare(self) -> None:
        """Restart the drive if its watchdog expired in a pause of the benchmark."""
        if self._drive.status().fault is not None:
            self._drive.start()

    def __call__(self) -> None:
        """Send one command."""
        self._drive.command(SLOW_M_PER_S)


def acceleration_of(drive: Drive) -> Call:
    """Return what sets a drive's acceleration."""
    assert isinstance(drive, Cia402Drive)
    return lambda: drive._node.write(0x6083, 0, 1_000)
