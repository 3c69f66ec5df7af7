"""Drives and their emulators, in virtual time on lines in memory, or on real lines of one process.

Both are a `Bench`. On a real line a thread polls the emulator.
"""

import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import can

from display_node.hardware import build_display_drive
from display_node.plant.scene import StepperScene
from protocol.wire.description import LayerTable
from pulse_drives.drive import Drive
from pulse_drives.scene import Cia402Scene, TmclScene
from pulse_drives.stepdir.scene import StepdirScene
from pulse_sensors.drive_film import DriveFilmScene
from telepulse.emulators import PtyPort
from telepulse.emulators.cia402 import ALL_MODES, EmulatedCia402Node
from telepulse.emulators.motor import TICK_NS
from telepulse.emulators.stepdir import serve_board
from telepulse.emulators.tmcl import EmulatedCanLine, EmulatedSerialLine, EmulatedTmclModule
from tests.support.fault_injection import FaultyBoard, FaultyMotor
from tests.support.slcan import SlcanBus
from tests.support.virtual_lines import virtual_line
from tests.support.virtual_time import VirtualTime
from tests.support.waiting import polled

LAYER = LayerTable().layer()
FORCE_LIMIT_N = 2.5
# For a machine so busy that threads wait: far longer than a bench's usual 50 ms.
PATIENT = {"watchdog": "800 ms", "homing_speed": "20 mm/s", "touch": "0.6 mm"}
LONGEST_WAIT_S = 20.0


AnyScene = TmclScene | Cia402Scene | StepdirScene
ON_SERIAL = ("tmcl", "stepdir")
# The highest step rate of a display board, at 16 microsteps.
BOARD_SPEED = "20 mm/s"


def stepper(**keys: Any) -> StepperScene:
    return StepperScene.model_validate({"kind": "stepper", **keys})


def actuator_of(kind: str) -> StepperScene:
    """Return an actuator as fast as a kind of drive can turn it."""
    return stepper(max_speed=BOARD_SPEED) if kind == "stepdir" else stepper()


def tmcl_scene(**keys: Any) -> TmclScene:
    return TmclScene.model_validate({"kind": "tmcl", **keys})


def cia402_scene(**keys: Any) -> Cia402Scene:
    table = {"kind": "cia402", "interface": "virtual", "channel": "c", **keys}
    return Cia402Scene.model_validate(table)


def stepdir_scene(**keys: Any) -> StepdirScene:
    table = {"kind": "stepdir", "fault_pin": "low", **keys}
    return StepdirScene.model_validate(table)


@dataclass
class Bench:
    """A drive, and the emulator at the other end of its line.

    line: in virtual time the port of a TMCL module or a display board, or our end of a CiA 402
    drive's bus; otherwise the pseudo-terminal. bus: the bus that python-can opens in virtual time.
    """

    scene: AnyScene
    actuator: StepperScene
    motor: FaultyMotor | FaultyBoard
    emulator: Any = None
    line: Any = None
    bus: Any = None
    clock: Any = time

    def __post_init__(self) -> None:
        self.drive: Drive = build_display_drive(self.scene, self.actuator, LAYER, FORCE_LIMIT_N)

    def wait(self, until: Callable[[], object], step: Callable[[], object] = bool) -> None:
        """Take steps until something holds."""
        deadline_s = self.clock.monotonic() + LONGEST_WAIT_S
        while not until():
            assert self.clock.monotonic() < deadline_s, self.drive.status()
            step()
            self.clock.sleep(0.002)

    def keep(self, rate_hz: float, until: Callable[[], object]) -> None:
        """Repeat the command of a signed step rate until something holds."""
        speed_m_per_s = rate_hz * self.actuator.step_m
        self.wait(until, lambda: self.drive.command(speed_m_per_s))

    def start(self, rate_hz: float = 0.0, tip_m: float = 0.0) -> None:
        """Start the drive; press at a rate until the tip is as deep as that."""
        self.drive.start()
        if rate_hz:
            self.keep(rate_hz, lambda: self.motor.rate_hz > 0 and self.motor.tip_m > tip_m)

    @property
    def fault(self) -> str:
        return self.drive.status().fault or ""

    @property
    def at_rest(self) -> bool:
        return self.motor.rate_hz == 0.0


def drive_scene(kind: str, place: str, **keys: Any) -> AnyScene:
    """Return the scene of a drive on a serial port (`ON_SERIAL`) or a CAN channel (other kinds)."""
    if kind == "stepdir":
        return stepdir_scene(port=place, **keys)
    if kind.startswith("cia402"):
        return cia402_scene(**{"channel": place, **keys})
    if kind == "tmcl":
        return tmcl_scene(port=place, **keys)
    return tmcl_scene(**{"interface": "virtual", "channel": place, **keys})


def emulated_motor(
    scene: AnyScene, actuator: StepperScene, now_ns: int, film: DriveFilmScene | None = None
) -> FaultyMotor | FaultyBoard:
    """Return the motor of a scene, or its display board, which has its own."""
    law = actuator.contact(LAYER)
    if isinstance(scene, StepdirScene):
        return FaultyBoard(scene, actuator, law, film, now_ns)
    return FaultyMotor(actuator, law, scene.touch_m, now_ns)


@contextmanager
def virtual_bench(
    kind: str,
    actuator: StepperScene | None = None,
    modes: Any = ALL_MODES,
    also: tuple[str, ...] = (),
    film: DriveFilmScene | None = None,
    **keys: Any,
) -> Iterator[Bench]:
    """Provide a bench in virtual time.

    kind: "tmcl", "tmcl-can", "cia402" or "stepdir". also: further modules that run in virtual time.
    film: on the line of a display board.
    """
    keys = {"homing_speed": "20 mm/s", "touch": "0.6 mm", **keys}
    scene = drive_scene(kind, "virtual" if kind in ON_SERIAL else "c", **keys)
    world, actuator = VirtualTime(), actuator or actuator_of(kind)
    motor = emulated_motor(scene, actuator, world.now_ns, film)
    with virtual_line(world, scene, motor, also, modes) as ends:
        bench = Bench(scene, actuator, motor, *ends, clock=world)
        world.every(TICK_NS, lambda: motor.advance(world.now_ns))
        yield bench
        bench.drive.close()


@contextmanager
def real_bench(kind: str, **keys: Any) -> Iterator[Bench]:
    """Provide a bench on a real line.

    kind: "tmcl", "stepdir", "tmcl-can", "cia402", or one of the last two with "-slcan".
    """
    port, channel = PtyPort(None), uuid.uuid4().hex
    bus: Any = None
    if "slcan" in kind:
        channel, bus = str(port.path), SlcanBus(port)
        keys |= {"interface": "slcan", "options": {"sleep_after_open": 0.0}}
    elif kind not in ON_SERIAL:
        bus = can.Bus(interface="virtual", channel=channel)
    if kind.startswith("tmcl"):
        keys["reply_timeout"] = "100 ms"
    if kind == "stepdir":
        keys = {"watchdog": "500 ms", **keys}
    place = str(port.path) if kind in ON_SERIAL else channel
    scene = drive_scene(kind, place, **(PATIENT | keys))
    actuator = actuator_of(kind)
    motor = emulated_motor(scene, actuator, time.perf_counter_ns())
    bench = Bench(scene, actuator, motor, line=port)
    if isinstance(scene, Cia402Scene):
        node = bench.emulator = EmulatedCia402Node(scene, motor, bus)
        parts: list[Callable[[], object]] = [partial(time.sleep, 0.001), node.poll]
        close = node.close
    elif isinstance(scene, StepdirScene):
        bench.emulator = motor
        parts = [partial(serve_board(motor, port), 0.001)]
        close = port.close
    else:
        module = bench.emulator = EmulatedTmclModule(scene, motor)
        line = (
            EmulatedSerialLine(module, port) if bus is None else EmulatedCanLine(module, scene, bus)
        )
        parts = [partial(line.serve, 0.002), lambda: motor.advance(time.perf_counter_ns())]
        close = port.close if bus is None else bus.shutdown
    with closing(bench.drive), polled(lambda: [part() for part in parts]):
        yield bench
        bench.drive.close()
    close()
    if bus is not None:
        bus.shutdown()
