"""Real drives: cost of a velocity command, and rate of commands on a serial line.

The emulated drives answer from a thread of this process. A virtual bus has no arbitration and no
bit rate, and a pseudo-terminal no baud rate: real ones add their own times.
"""

import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

import can
import numpy as np
from pytrinamic.connections.tmcl_interface import TmclInterface

from benchmarks.benchmark import Benchmark
from display_node.hardware import build_display_drive
from display_node.plant.scene import StepperScene
from protocol.wire.stream import LayerTable
from pulse_drives.axis import build_axis
from pulse_drives.cia402.drive import Cia402Drive
from pulse_drives.cia402.node import Cia402Node
from pulse_drives.cia402.state_machine import Controlword, Mode
from pulse_drives.drive import Drive
from pulse_drives.scene import TMCL_BITS, Cia402Scene, TmclScene
from pulse_drives.tmcl.line import TmclLine
from pulse_drives.tmcl.module import Command
from telepulse.emulators import PtyPort
from telepulse.emulators.cia402 import EmulatedCia402Node
from telepulse.emulators.motor import EmulatedMotor
from telepulse.emulators.tmcl import EmulatedCanLine, EmulatedSerialLine, EmulatedTmclModule
from tests.support.drive_benches import polled
from tests.support.slcan import SlcanBus

RUNS = 5
CALLS = 500
BAUDS = (9_600, 57_600, 115_200, 500_000, 1_000_000)
LAYER = LayerTable().layer()
ACTUATOR = StepperScene.model_validate({"kind": "stepper"})
FORCE_LIMIT_N = 2.5
CAN_BUS = {"interface": "virtual", "channel": "benchmark"}
# Without homing, and with first touch at the present position, the drive starts at once.
HERE = {"homing": "none", "touch": "0 m", "watchdog": "1 s"}
TMCL = {"kind": "tmcl", "reply_timeout": "200 ms", **HERE}
# One step per second.
SLOW_M_PER_S = StepperScene(kind="stepper").step_m

Call = Callable[[], object]


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    with ExitStack() as open_things:
        calls = {
            **open_things.enter_context(pdos_to_nobody()),
            **open_things.enter_context(cia402_calls("virtual CAN", CAN_BUS, can.Bus(**CAN_BUS))),  # type: ignore[arg-type]
            **open_things.enter_context(slcan_calls()),
            **open_things.enter_context(tmcl_calls()),
        }
        # Interleaved, so that a busy moment of the machine affects all equally.
        count = 1 if benchmark.quick else RUNS
        runs = [{name: percentiles(call) for name, call in calls.items()} for _ in range(count)]
    pdo_us = statistics.median(run["PDO"][1] for run in runs)
    benchmark.judge("PDO of a velocity command, 99th percentile", pdo_us * 1e-6)
    benchmark.table(
        f"One velocity command in µs, median of {count} interleaved runs of {CALLS}. CPU: of the"
        " calling thread only",
        ("what", "p50", "p99", "CPU p50", "CPU p99"),
        [(name, *(median([run[name][k] for run in runs]) for k in range(4))) for name in calls],
    )
    benchmark.table(
        "Commands to a TMCL module on a serial line: request and reply are 9 bytes each",
        ("baud", "request and reply, ms", "commands a second, at most"),
        [line_row(2e3 * TMCL_BITS / baud, baud) for baud in BAUDS],
    )


def line_row(both_ms: float, baud: int) -> tuple[str, ...]:
    """Return a line's row; both_ms: a request and its reply."""
    return str(baud), f"{both_ms:.2f}", f"{1e3 / both_ms:.0f}"


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


def median(values: list[float]) -> str:
    """Return the median as text."""
    return f"{statistics.median(values):.0f}"


@contextmanager
def pdos_to_nobody() -> Iterator[dict[str, Call]]:
    """Provide the cost of sending alone: no thread reads the other end of the bus."""
    bus = {**CAN_BUS, "channel": "nobody"}
    scene = Cia402Scene.model_validate({"kind": "cia402", **bus})
    node = Cia402Node(
        scene, build_axis(scene, ACTUATOR, ACTUATOR.deepest_m(LAYER, FORCE_LIMIT_N)), Counter()
    )
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


@contextmanager
def cia402_calls(
    where: str, keys: dict[str, Any], far_end: can.BusABC
) -> Iterator[dict[str, Call]]:
    """Provide commands to an emulated CiA 402 drive on a bus, as the force loop gives them."""
    scene = Cia402Scene.model_validate({"kind": "cia402", **keys, **HERE})
    emulated = EmulatedCia402Node(scene, motor(scene.touch_m), far_end)

    def poll() -> None:
        time.sleep(0.001)
        emulated.poll()

    with polled(poll):
        drive = build_display_drive(scene, ACTUATOR, LAYER, FORCE_LIMIT_N)
        assert isinstance(drive, Cia402Drive)
        yield {
            f"CiA 402 command (PDO, SYNC, heartbeat), {where}": Commands(drive),
            f"CiA 402 SDO write and its answer, {where}": lambda: written(drive),
        }
        drive.close()
    emulated.close()


@contextmanager
def slcan_calls() -> Iterator[dict[str, Call]]:
    """Provide the same through an emulated CAN adapter on a pseudo-terminal, in bytes."""
    port = PtyPort(None)
    keys = {"interface": "slcan", "channel": str(port.path), "options": {"sleep_after_open": 0}}
    with cia402_calls("slcan", keys, SlcanBus(port)) as calls:
        yield calls


@contextmanager
def tmcl_calls() -> Iterator[dict[str, Call]]:
    """Provide requests to emulated TMCL modules, and the mailbox before one."""
    with ExitStack() as open_things:
        port = PtyPort(None)
        on_pty = TmclScene.model_validate({**TMCL, "port": str(port.path)})
        on_can = TmclScene.model_validate({**TMCL, **CAN_BUS, "module": 9})
        boxed_port = PtyPort(None)
        boxed = TmclScene.model_validate({**TMCL, "port": str(boxed_port.path)})
        for server in (
            EmulatedSerialLine(EmulatedTmclModule(on_pty, motor(0.0)), port),
            EmulatedCanLine(EmulatedTmclModule(on_can, motor(0.0)), on_can, can.Bus(**CAN_BUS)),  # type: ignore[arg-type]
            EmulatedSerialLine(EmulatedTmclModule(boxed, motor(boxed.touch_m)), boxed_port),
        ):
            open_things.callback(server.close)
            open_things.enter_context(polled(partial(server.serve, 0.005)))
        lines = TmclLine(on_pty, Counter()), TmclLine(on_can, Counter())
        drive = build_display_drive(boxed, ACTUATOR, LAYER, FORCE_LIMIT_N)
        yield {
            "TMCL drive: command (mailbox)": Commands(drive),
            "TMCL request and reply, pseudo-terminal": lambda: rotate(lines[0]),
            "the same, with PyTrinamic's log lines": lambda: rotate_and_log(lines[0]),
            "TMCL request and reply, virtual CAN": lambda: rotate(lines[1]),
        }
        drive.close()
        for line in lines:
            line.close()


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


def written(drive: Cia402Drive) -> None:
    """Set the drive's acceleration."""
    drive._node.write(0x6083, 0, 1_000)


def rotate(line: TmclLine) -> None:
    """Send one velocity command."""
    line.request(Command.ROTATE_RIGHT, 0, 0, 1)


def rotate_and_log(line: TmclLine) -> None:
    """Send the same as PyTrinamic's own interfaces do."""
    MakersInterface(line).send(Command.ROTATE_RIGHT, 0, 0, 1)


class MakersInterface(TmclInterface):  # type: ignore[misc]
    """PyTrinamic's own exchange on the carrier of a line."""

    def __init__(self, line: TmclLine) -> None:
        super().__init__()
        self._carrier = line.carrier

    def _send(self, host_id: int, module_id: int, data: bytes) -> None:
        self._carrier.send(data)

    def _recv(self, host_id: int, module_id: int) -> bytes:
        return self._carrier.receive()


def motor(touch_m: float) -> EmulatedMotor:
    """Return the emulated drives' motor."""
    return EmulatedMotor(ACTUATOR, ACTUATOR.contact(LAYER), touch_m, time.perf_counter_ns())
