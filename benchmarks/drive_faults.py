"""Faults of real drives: time for which the emulated motor continues after each.

The motor runs at 5 mm/s, a fast pulse's speed, and its watchdog is the default, 50 ms.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import can

from benchmarks.benchmark import Benchmark
from benchmarks.drives import ACTUATOR, CAN_BUS, FORCE_LIMIT_N, LAYER, motor
from display_node.hardware import build_display_drive
from pulse_drives import Drive
from pulse_drives.scene import Cia402Scene, TmclScene
from telepulse.emulators import PtyPort
from telepulse.emulators.cia402 import EmulatedCia402Node
from telepulse.emulators.motor import EmulatedMotor
from telepulse.emulators.tmcl import EmulatedSerialLine, EmulatedTmclModule
from tests.support.drive_benches import polled

REPEATS = 5
BAR_MS = 100.0
HERE = {"homing": "none", "touch": "0 m"}
PRESS_M_PER_S = 5e-3
PERIOD_S = 2e-3
BEFORE_S = 0.06
AFTER_S = 0.25


@dataclass
class MovingDrive:
    """A moving drive, and the emulator at its far end. plugged: it is connected."""

    drive: Drive
    motor: EmulatedMotor
    emulator: Any
    plugged: bool = True


def main(benchmark: Benchmark) -> None:
    """Print the table; the bar is 100 ms."""
    benchmark.table(
        f"From a fault to rest, most of {REPEATS}; the bar is {BAR_MS:g} ms",
        ("drive", "what happens", "ms", "named"),
        [
            *(row("TMCL", tmcl_bench, event, happens) for event, happens in TMCL_EVENTS.items()),
            *(row("CiA 402", cia402_bench, event, it) for event, it in CIA402_EVENTS.items()),
        ],
    )


def row(
    kind: str,
    make: Callable[[], Any],
    event: str,
    happens: Callable[[MovingDrive], None],
) -> tuple[str, ...]:
    """Return a fault's row."""
    times_ms, named = list[float](), ""
    while len(times_ms) < REPEATS:
        with make() as bench:
            bench.drive.start()
            press(bench, BEFORE_S)
            if bench.drive.status().fault is not None:
                continue  # on a busy machine the watchdog has expired before the fault
            happened_ns = time.perf_counter_ns()
            happens(bench)
            press(bench, AFTER_S if event != NO_COMMAND else 0.0)
            while bench.motor.rate_hz or bench.drive.status().fault is None:
                time.sleep(PERIOD_S)
            # The motor's time is in whole ms and may be just before the fault's.
            times_ms.append(max(0.0, (bench.motor.rested_ns - happened_ns) / 1e6))
            named = str(bench.drive.status().fault).split(":")[0]
    return kind, event, f"{max(times_ms):.0f}", named


def press(bench: MovingDrive, seconds: float) -> None:
    """Command a speed for a time, as a force loop that has detected no fault does."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        bench.drive.command(PRESS_M_PER_S)
        time.sleep(PERIOD_S)


@contextmanager
def tmcl_bench() -> Iterator[MovingDrive]:
    """Provide a TMCL drive on a pseudo-terminal."""
    port = PtyPort(None)
    scene = TmclScene.model_validate({"kind": "tmcl", "port": str(port.path), **HERE})
    turned = motor(0.0)
    module = EmulatedTmclModule(scene, turned)
    line = EmulatedSerialLine(module, port)
    bench = MovingDrive(build_display_drive(scene, ACTUATOR, LAYER, FORCE_LIMIT_N), turned, module)

    open_line = ExitStack()
    open_line.callback(line.close)

    def poll() -> None:
        if bench.plugged:
            line.serve(1e-3)
        else:
            open_line.close()
            time.sleep(1e-3)
        turned.advance(time.perf_counter_ns())

    with open_line, polled(poll):
        yield bench
        bench.drive.close()


@contextmanager
def cia402_bench() -> Iterator[MovingDrive]:
    """Provide a CiA 402 drive on a virtual bus."""
    scene = Cia402Scene.model_validate({"kind": "cia402", **CAN_BUS, **HERE})
    turned = motor(0.0)
    node = EmulatedCia402Node(scene, turned, can.Bus(**CAN_BUS))  # type: ignore[arg-type]

    def poll() -> None:
        time.sleep(1e-3)
        node.poll()

    with polled(poll):
        bench = MovingDrive(
            build_display_drive(scene, ACTUATOR, LAYER, FORCE_LIMIT_N), turned, node
        )
        yield bench
        bench.drive.close()
    node.close()


def break_motor(bench: MovingDrive) -> None:
    """Make the drive too hot."""
    bench.motor.fail("overtemperature")


def answer(how: str) -> Callable[[MovingDrive], None]:
    """Return a fault that makes the module reply in this way."""

    def happens(bench: MovingDrive) -> None:
        bench.emulator.answer_mode = how

    return happens


def fall_silent(bench: MovingDrive) -> None:
    """Make the drive receive without answering."""
    bench.emulator.silent = True


def unplug(bench: MovingDrive) -> None:
    """Remove the port."""
    bench.plugged = False


def nothing(bench: MovingDrive) -> None:
    """Send no more commands, as a process that hangs or is killed."""


NO_COMMAND = "no further command"
TMCL_EVENTS = {
    "over-temperature": break_motor,
    "no replies": answer("silent"),
    "garbled replies": answer("garbled"),
    "replies to something else": answer("wrong"),
    "cable pulled": unplug,
    NO_COMMAND: nothing,
}
CIA402_EVENTS = {
    "over-temperature": break_motor,
    "silent drive": fall_silent,
    NO_COMMAND: nothing,
}
