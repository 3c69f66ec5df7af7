"""Lines to emulated drives in virtual time, in place of pyserial's ports and python-can's buses."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch

import can

from protocol.config.kinds import load_object
from pulse_drives.scene import Cia402Scene, DriveScene, TmclScene
from telepulse.emulators.cia402 import ALL_MODES, EmulatedCia402Node
from telepulse.emulators.motor import TICK_NS
from telepulse.emulators.stepdir import EmulatedBoard
from telepulse.emulators.tmcl import DatagramSplitter, EmulatedTmclModule, checksum
from tests.support.fault_injection import (
    FaultyBoard,
    FaultyCia402Node,
    FaultyMotor,
    FaultyTmclModule,
)
from tests.support.virtual_time import VirtualEvent, VirtualTime

# Modules that wait or read the clock.
VIRTUAL = ("pulse_drives", "telepulse.emulators", "tests.support.fault_injection")
# A line to a module on USB, each way.
LINE_NS = 200_000
# Size of a kernel's buffer for a serial port.
PORT_BYTES = 4096
SDO_ANSWERS = range(0x580, 0x600)


class Pipe:
    """Bytes on their way to a reader; bytes beyond a kernel's buffer are dropped."""

    def __init__(self, world: VirtualTime) -> None:
        self._data = b""
        self._come = VirtualEvent(world)

    def write(self, data: bytes) -> None:
        self._data += data[: PORT_BYTES - len(self._data)]
        self._come.set()

    @property
    def waiting(self) -> int:
        return len(self._data)

    def read(self, size: int, timeout_s: float) -> bytes:
        """Wait for any bytes, and take up to `size` of them."""
        if not self._data:
            self._come.clear()
            self._come.wait(timeout_s)
        data, self._data = self._data[:size], self._data[size:]
        return data


class ModulePort:
    """The serial port to an emulated TMCL module, in place of pyserial's."""

    def __init__(self, world: VirtualTime, module: EmulatedTmclModule) -> None:
        self._world, self._module = world, module
        self._datagrams = DatagramSplitter()
        self.replies = Pipe(world)
        self.timeout_s = 0.01
        self.unplugged = False

    def write(self, data: bytes) -> None:
        """Send a request, which arrives a little later."""
        if self.unplugged:
            raise OSError(5, "unplugged")
        self._world.at(self._world.now_ns + LINE_NS, lambda: self._receive(bytes(data)))

    def read(self, size: int) -> bytes:
        if self.unplugged:
            raise OSError(5, "unplugged")
        until_ns = self._world.now_ns + math.ceil(self.timeout_s * 1e9)
        data = self.replies.read(size, 0.0)
        while len(data) < size and self._world.now_ns < until_ns:
            data += self.replies.read(size - len(data), (until_ns - self._world.now_ns) * 1e-9)
        return data

    @property
    def in_waiting(self) -> int:
        return self.replies.waiting

    def reset_input_buffer(self) -> None:
        self.replies.read(PORT_BYTES, 0.0)

    def close(self) -> None:
        pass

    def poll(self) -> None:
        """Send the replies that are due."""
        for reply in self._module.due_answers(self._world.now_ns):
            self._world.at(self._world.now_ns + LINE_NS, partial(self.replies.write, reply))

    def _receive(self, data: bytes) -> None:
        if not self.unplugged:
            for request in self._datagrams.feed(data, self._world.now_ns):
                self._module.receive(request, self._world.now_ns)
            self.poll()


class BoardPort:
    """The serial port to an emulated display board, in place of pyserial's.

    full: it takes no bytes, as one whose buffer is full.
    """

    def __init__(self, world: VirtualTime, board: EmulatedBoard) -> None:
        self._world, self._board = world, board
        self.frames = Pipe(world)
        self.unplugged = self.full = False

    def open(self, *_: object, **__: object) -> "BoardPort":
        if self.unplugged:
            raise OSError(2, "unplugged")
        return self

    def write(self, data: bytes) -> int:
        """Send bytes, which arrive a little later."""
        if self.unplugged:
            raise OSError(5, "unplugged")
        if self.full:
            return 0
        self._world.at(self._world.now_ns + LINE_NS, lambda: self._receive(data))
        return len(data)

    def read(self, size: int) -> bytes:
        data = self.frames.read(size, 0.1) if size and not self.unplugged else b""
        if self.unplugged:
            raise OSError(5, "unplugged")
        return data

    @property
    def in_waiting(self) -> int:
        return self.frames.waiting

    def close(self) -> None:
        pass

    def poll(self) -> None:
        """Let the board go on, and send its frames."""
        self._receive(b"")

    def _receive(self, data: bytes) -> None:
        self._board.receive(b"" if self.unplugged else data, self._world.now_ns)
        for frame in self._board.due_frames():
            if not self.unplugged:
                self._world.at(self._world.now_ns + LINE_NS, partial(self.frames.write, frame))


class ModuleBus:
    """A CAN bus on which an emulated TMCL module is alone, in place of python-can's."""

    def __init__(self, port: ModulePort) -> None:
        self._port = port
        # Errors that the next calls raise.
        self.errors: deque[Exception] = deque()
        self.flushed = 0

    def set_filters(self, filters: object) -> None:
        pass

    def send(self, message: can.Message, timeout: float) -> None:
        request = bytes([message.arbitration_id, *message.data])
        self._port.write(request + bytes([checksum(request)]))

    def recv(self, timeout_s: float) -> can.Message | None:
        if timeout_s and self.errors:
            raise self.errors.popleft()
        self._port.timeout_s = timeout_s
        reply = self._port.read(9)
        return can.Message(arbitration_id=reply[0], data=reply[1:8]) if reply else None

    def flush(self) -> None:
        self.flushed += 1

    def shutdown(self) -> None:
        pass


class CanEnd(can.BusABC):
    """One end of a CAN bus of two, read by a `Notifier`; unplugged: nothing can be sent."""

    def __init__(self, at_drive: bool) -> None:
        super().__init__(channel="virtual time")
        self.channel_info = "virtual time"
        self.at_drive = at_drive
        self.far: CanEnd | None = None
        self.notifier: Notifier | None = None
        self.unplugged = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.unplugged:
            raise can.CanOperationError("unplugged")
        if self.far is not None and self.far.notifier is not None:
            # The sender may use the message again.
            data, identifier = bytes(msg.data), msg.arbitration_id
            frame = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
            self.far.notifier.receive(frame)

    def shutdown(self) -> None:
        self._is_shutdown = True

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return None, False


class Notifier:
    """The replacement of `can.Notifier`: a thread that passes frames to the listeners.

    Frames to the drive, and SDO answers, which come while their request is being sent, are passed
    on at once.
    """

    exception: Exception | None = None

    def __init__(self, world: VirtualTime, bus: CanEnd, listeners: list[Any]) -> None:
        self._world = world
        self.listeners = listeners
        self._at_drive = bus.at_drive
        self._frames: deque[can.Message] = deque()
        self._come = VirtualEvent(world)
        self._stopped = False
        bus.notifier = self
        if not self._at_drive:
            world.thread(self._run, name="notifier")

    def receive(self, frame: can.Message) -> None:
        """Take a frame from the bus."""
        at_once = self._at_drive or self._world.current is not None
        if at_once or frame.arbitration_id in SDO_ANSWERS:
            self._pass_on(frame)
        else:
            self._frames.append(frame)
            self._come.set()

    def stop(self, timeout: float = 5) -> None:
        self._stopped = True
        self._come.set()

    def _run(self) -> None:
        while not self._stopped:
            self._come.wait()
            self._come.clear()
            while self._frames:
                self._pass_on(self._frames.popleft())

    def _pass_on(self, frame: can.Message) -> None:
        for listener in self.listeners:
            listener(frame)


@contextmanager
def virtual_line(
    world: VirtualTime,
    scene: DriveScene,
    motor: FaultyMotor | FaultyBoard,
    also: Sequence[str] = (),
    modes: Any = ALL_MODES,
) -> Iterator[tuple[Any, ...]]:
    """Run a drive's emulator in virtual time, on a line that its driver opens for a real one.

    motor: a display board is its own emulator. also: further modules that run in virtual time.
    Yields the emulator; its port, or our end of the CAN bus of two; and a module's bus.
    """
    load_object(scene.driver)  # so that its clock is replaced too
    with world.substituted((*VIRTUAL, *also)):
        if isinstance(scene, Cia402Scene):
            with _cia402_line(world, scene, motor, modes) as ends:
                yield ends
        elif isinstance(motor, FaultyBoard):
            line = BoardPort(world, motor)
            world.every(TICK_NS, line.poll)
            with patch("serial.serial_for_url", line.open):
                yield motor, line
        else:
            assert isinstance(scene, TmclScene)
            module = FaultyTmclModule(scene, motor)
            port = ModulePort(world, module)
            bus = ModuleBus(port)
            world.every(TICK_NS, port.poll)
            with (
                patch("serial.serial_for_url", lambda *_, **__: port),
                patch("can.Bus", lambda **_: bus),
            ):
                yield module, port, bus


@contextmanager
def _cia402_line(
    world: VirtualTime, scene: Cia402Scene, motor: FaultyMotor, modes: Any
) -> Iterator[tuple[EmulatedCia402Node, CanEnd]]:
    ours, drives = CanEnd(at_drive=False), CanEnd(at_drive=True)
    ours.far, drives.far = drives, ours
    with (
        patch("can.Notifier", lambda bus, listeners, timeout=1.0: Notifier(world, bus, listeners)),
        patch("can.Bus", lambda **_: ours),
        closing(FaultyCia402Node(scene, motor, drives, modes)) as node,
    ):
        world.every(TICK_NS, node.poll)
        yield node, ours
        ours.shutdown()
