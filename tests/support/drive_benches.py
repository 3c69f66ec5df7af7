"""Drives and their emulators, in one process and on real lines."""

import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import can

from display_node.drives.axis import build_axis
from display_node.drives.cia402.drive import Cia402Drive
from display_node.drives.drive import Drive
from display_node.drives.scene import Cia402Scene, TmclScene
from display_node.drives.tmcl.drive import TmclDrive
from display_node.plant.stepper import StepperScene
from protocol.wire.stream import LayerTable
from telepulse.emulators.cia402 import ALL_MODES, EmulatedCia402Node
from telepulse.emulators.motor import EmulatedMotor
from telepulse.emulators.pty_port import PtyPort
from telepulse.emulators.slcan import SlcanBus
from telepulse.emulators.tmcl import EmulatedCanLine, EmulatedSerialLine, EmulatedTmclModule

LAYER = LayerTable().layer()
FORCE_LIMIT_N = 2.5
# Of a machine so busy that a thread waits for its turn: far longer than a bench's 50 ms.
PATIENT = {"watchdog": "800 ms", "homing_speed": "20 mm/s", "touch": "0.6 mm"}
LONGEST_WAIT_S = 20.0


def stepper(**keys: Any) -> StepperScene:
    return StepperScene.model_validate({"kind": "stepper", **keys})


def tmcl_scene(**keys: Any) -> TmclScene:
    table = {"kind": "tmcl", "reply_timeout": "100 ms", **PATIENT, **keys}
    return TmclScene.model_validate(table)


def cia402_scene(**keys: Any) -> Cia402Scene:
    table = {"kind": "cia402", "interface": "virtual", "channel": uuid.uuid4().hex}
    return Cia402Scene.model_validate({**table, **PATIENT, **keys})


def emulated_motor(scene: TmclScene | Cia402Scene, actuator: StepperScene) -> EmulatedMotor:
    law = actuator.contact(LAYER)
    return EmulatedMotor(actuator, law, scene.touch_m, time.monotonic_ns())


@contextmanager
def polled(poll: Callable[[], object]) -> Iterator[Callable[[], None]]:
    """Call `poll` in a thread; yield a function that ends it before the end of the block."""
    over = threading.Event()

    def run() -> None:
        while not over.is_set():
            poll()

    def end() -> None:
        over.set()
        thread.join()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield end
    finally:
        end()


@dataclass
class Bench:
    """A drive, and what is at the other end of its line."""

    drive: Drive
    motor: EmulatedMotor
    emulator: Any
    unplug: Callable[[], None]
    actuator: StepperScene
    line: Any = None

    def keep(self, rate_hz: float, until: Callable[[], bool]) -> None:
        """Command a signed step rate over and over until something holds."""
        speed_m_per_s = rate_hz * self.actuator.step_m

        def step() -> bool:
            self.drive.command(speed_m_per_s)
            return until()

        wait(step)

    @property
    def at_rest(self) -> bool:
        return self.motor.rate_hz == 0.0


def wait(until: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + LONGEST_WAIT_S
    while not until():
        assert time.monotonic() < deadline_s, "waited for nothing"
        time.sleep(0.002)


@contextmanager
def tmcl_bench(
    on_can: bool = False,
    actuator: StepperScene | None = None,
    by_slcan: bool = False,
    **keys: Any,
) -> Iterator[Bench]:
    actuator = actuator or stepper()
    if by_slcan:
        port = PtyPort(None)
        at_port = {"interface": "slcan", "channel": str(port.path)}
        scene = tmcl_scene(**at_port, options={"sleep_after_open": 0.0}, **keys)
        motor = emulated_motor(scene, actuator)
        module = EmulatedTmclModule(scene, motor)
        line: EmulatedCanLine | EmulatedSerialLine = EmulatedCanLine(module, scene, SlcanBus(port))
    elif on_can:
        channel = uuid.uuid4().hex
        scene = tmcl_scene(interface="virtual", channel=channel, **keys)
        bus = can.Bus(interface="virtual", channel=channel)
        motor = emulated_motor(scene, actuator)
        module = EmulatedTmclModule(scene, motor)
        line = EmulatedCanLine(module, scene, bus)
    else:
        port = PtyPort(None)
        scene = tmcl_scene(port=str(port.path), **keys)
        motor = emulated_motor(scene, actuator)
        module = EmulatedTmclModule(scene, motor)
        line = EmulatedSerialLine(module, port)
    plugged = True

    def poll() -> None:
        if plugged:
            line.serve(0.002)
        else:
            time.sleep(0.002)
        motor.advance(time.monotonic_ns())

    def unplug() -> None:
        nonlocal plugged
        if plugged:
            plugged = False
            time.sleep(0.01)
            line.close()

    drive = TmclDrive(scene, build_axis(scene, actuator, LAYER, FORCE_LIMIT_N))
    with polled(poll) as end:
        try:
            yield Bench(drive, motor, module, unplug, actuator, line)
        finally:
            drive.close()
            end()
            unplug()


def at_the_far_end(scene: Cia402Scene | TmclScene) -> can.BusABC:
    """The bus that an emulated drive is on."""
    return can.Bus(interface=scene.interface, channel=scene.channel)


@contextmanager
def slcan_bench(**keys: Any) -> Iterator[Bench]:
    """A CiA 402 drive behind an adapter on a pseudo-terminal."""
    port = PtyPort(None)
    table = {"interface": "slcan", "channel": str(port.path)}
    options = {"options": {"sleep_after_open": 0.0}}
    with cia402_bench(far_end=lambda _: SlcanBus(port), **table, **options, **keys) as bench:
        yield bench


@contextmanager
def cia402_bench(
    actuator: StepperScene | None = None,
    modes: Any = ALL_MODES,
    far_end: Callable[[Cia402Scene], can.BusABC] = at_the_far_end,
    **keys: Any,
) -> Iterator[Bench]:
    actuator = actuator or stepper()
    scene = cia402_scene(**keys)
    motor = emulated_motor(scene, actuator)
    bus = far_end(scene)
    node = EmulatedCia402Node(scene, motor, bus, modes)

    def poll() -> None:
        time.sleep(0.001)
        node.poll()

    drive = Cia402Drive(scene, build_axis(scene, actuator, LAYER, FORCE_LIMIT_N))
    with polled(poll) as end:
        try:
            yield Bench(drive, motor, node, bus.shutdown, actuator)
        finally:
            drive.close()
            end()
            node.close()


@contextmanager
def shared_bus() -> Iterator[tuple[Bench, can.BusABC]]:
    """A CiA 402 drive that has started, and another node's end of its bus."""
    channel = uuid.uuid4().hex
    with (
        cia402_bench(channel=channel) as bench,
        can.Bus(interface="virtual", channel=channel) as bus,
    ):
        bench.drive.start()
        yield bench, bus
