"""An emulated TMCL stepper module, on a pseudo-terminal or a CAN bus.

The module itself is pure: it returns the replies that the firmware would send. Modelled are the
commands, parameters and flags that our driver uses. Not modelled: TMCL programs, positioning,
currents, the other motors of a module, and the time that a real line takes for a datagram.
"""

import struct
import time
from collections import deque
from typing import TYPE_CHECKING

from protocol.host.descriptors import DescriptorSet
from pulse_drives.scene import TmclScene
from pulse_drives.tmcl.module import (
    LEFT_SWITCH,
    RIGHT_SWITCH,
    Command,
    DriverFlag,
    ErrorFlag,
    Global,
    Parameter,
    Search,
)
from telepulse.emulators import PtyPort
from telepulse.emulators.motor import EmulatedMotor

if TYPE_CHECKING:
    import can

DATAGRAM = struct.Struct(">BBBBiB")
SUCCESS = 100
WRONG_CHECKSUM, INVALID_COMMAND, WRONG_TYPE, INVALID_VALUE = 1, 2, 3, 4
# The low 16 bits are version 1.0, the high ones the module's number; no module has 9999.
VERSION = 9999 << 16 | 1 << 8
# After a pause this long in the middle of a datagram, the next byte begins a new one.
PAUSE_NS = 5_000_000

ANSWER_FAULTS = ("silent", "late", "wrong", "garbled")


def checksum(data: bytes) -> int:
    """Return the last byte of a datagram: the sum of those before it."""
    return sum(data) & 0xFF


class DatagramSplitter:
    """Splitter of a serial line's bytes into requests."""

    def __init__(self) -> None:
        self._bytes = b""
        self._received_ns = 0

    def feed(self, data: bytes, now_ns: int) -> list[bytes]:
        """Return the whole requests in these bytes and those left from before."""
        if now_ns - self._received_ns > PAUSE_NS:
            self._bytes = b""
        self._received_ns = now_ns
        self._bytes += data
        whole = len(self._bytes) // DATAGRAM.size * DATAGRAM.size
        requests, self._bytes = self._bytes[:whole], self._bytes[whole:]
        return [requests[i : i + DATAGRAM.size] for i in range(0, whole, DATAGRAM.size)]


class EmulatedTmclModule:
    """Module that executes requests, moves the motor and queues the answers.

    answer_mode: "right", or one of `ANSWER_FAULTS` for the driver to detect. late_s: delay of
    answers in mode "late".
    """

    def __init__(self, scene: TmclScene, motor: EmulatedMotor) -> None:
        self._scene, self._motor = scene, motor
        self._answers: deque[tuple[int, bytes]] = deque()
        self._direction = -1 if scene.inverted else 1
        self._axis: dict[int, int] = {
            Parameter.SEARCH_MODE: LEFT_SWITCH,
            Parameter.SEARCH_SPEED: self._units(5e3),
            Parameter.SWITCH_SPEED: self._units(1e3),
            Parameter.MAX_SPEED: self._units(1e6),
            Parameter.MAX_ACCELERATION: 0,
            Parameter.MICROSTEPS: 4,
        }
        self._global = {int(Global.SERIAL_HEARTBEAT): 0, int(Global.CAN_HEARTBEAT): 0}
        self.answer_mode = "right"
        self.late_s = 0.03

    def receive(self, request: bytes, now_ns: int) -> None:
        """Execute a request of 9 bytes, and queue the answer."""
        if reply := self.reply(request, now_ns):
            late_s = self.late_s if self.answer_mode == "late" else 0.0
            self._answers.append((now_ns + round(late_s * 1e9), reply))

    def due_answers(self, now_ns: int) -> list[bytes]:
        """Return the answers that are to be sent by now, in their order."""
        due = []
        while self._answers and self._answers[0][0] <= now_ns:
            due.append(self._answers.popleft()[1])
        return due

    def reply(self, request: bytes, now_ns: int) -> bytes:
        """Return 9 bytes of reply to 9 bytes of request; empty for another module's request."""
        address, command, kind, motor, value, check = DATAGRAM.unpack(request)
        self._motor.advance(now_ns)
        if address != self._scene.module or self.answer_mode == "silent":
            return b""
        if checksum(request[:-1]) != check:
            status = WRONG_CHECKSUM
        else:
            self._motor.feed()
            status, value = self._execute(command, kind, motor, value)
        if self.answer_mode == "wrong":
            command ^= 0x40
        body = DATAGRAM.pack(self._scene.host, self._scene.module, status, command, value, 0)[:-1]
        check = checksum(body) + (self.answer_mode == "garbled")
        return body + bytes([check & 0xFF])

    def _execute(self, command: int, kind: int, motor: int, value: int) -> tuple[int, int]:
        """Execute a command; return status and value of the reply."""
        match command:
            case Command.SET_GLOBAL | Command.GET_GLOBAL:
                return self._global_parameter(command, kind, motor, value)
            case Command.FIRMWARE_VERSION:
                return SUCCESS, VERSION
            case _ if motor != self._scene.motor:
                return INVALID_VALUE, value
            case Command.ROTATE_RIGHT | Command.ROTATE_LEFT:
                sign = 1 if command == Command.ROTATE_RIGHT else -1
                self._motor.run(self._rate_hz(sign * value))
            case Command.MOTOR_STOP:
                self._motor.run(0.0)
            case Command.SET_AXIS:
                return self._set_axis(kind, value), value
            case Command.GET_AXIS:
                return self._get_axis(kind)
            case Command.REFERENCE_SEARCH:
                return self._search(kind)
            case _:
                return INVALID_COMMAND, value
        return SUCCESS, value

    def _set_axis(self, kind: int, value: int) -> int:
        if kind == Parameter.ACTUAL_POSITION and not value:
            self._motor.zero()
            return SUCCESS
        if kind not in (Parameter.ACTUAL_POSITION, *self._axis):
            return WRONG_TYPE
        most = {Parameter.ACTUAL_POSITION: 0, Parameter.MICROSTEPS: 8}.get(Parameter(kind), value)
        if not 0 <= value <= most:
            return INVALID_VALUE
        self._axis[kind] = value
        return SUCCESS

    def _get_axis(self, kind: int) -> tuple[int, int]:
        motor = self._motor
        home = Parameter.RIGHT_SWITCH_STATE if self._direction < 0 else Parameter.LEFT_SWITCH_STATE
        match kind:
            case Parameter.ACTUAL_POSITION:
                return SUCCESS, self._direction * motor.position_steps
            case Parameter.ACTUAL_SPEED:
                return SUCCESS, self._units(self._direction * motor.counter_hz)
            case Parameter.ERROR_FLAGS:
                flags = {"stall": ErrorFlag.STALL, "following error": ErrorFlag.DEVIATION}
                flag = flags.get(motor.fault or "", ErrorFlag(0))
                if flag:
                    # Reading clears these two.
                    motor.reset()
                return SUCCESS, flag
            case Parameter.RIGHT_SWITCH_STATE | Parameter.LEFT_SWITCH_STATE:
                return SUCCESS, int(kind == home and motor.at_switch)
            case Parameter.DRIVER_FLAGS:
                return SUCCESS, DriverFlag.OVERTEMPERATURE * (motor.fault == "overtemperature")
        return (SUCCESS, self._axis[kind]) if kind in self._axis else (WRONG_TYPE, 0)

    def _global_parameter(self, command: int, kind: int, bank: int, value: int) -> tuple[int, int]:
        if bank or kind not in self._global:
            return WRONG_TYPE, value
        if command == Command.SET_GLOBAL:
            if not 0 <= value <= 65535:
                return INVALID_VALUE, value
            self._global[kind] = value
            on_serial = self._scene.port is not None
            if kind == (Global.SERIAL_HEARTBEAT if on_serial else Global.CAN_HEARTBEAT):
                self._motor.set_watchdog(value * 1_000_000)
        return SUCCESS, self._global[kind]

    def _search(self, kind: int) -> tuple[int, int]:
        match kind:
            case Search.START:
                on_right = self._axis[Parameter.SEARCH_MODE] & (LEFT_SWITCH ^ RIGHT_SWITCH)
                if bool(on_right) != self._scene.inverted:
                    # Only the side away from the finger has a switch.
                    return INVALID_VALUE, 0
                speeds = (self._axis[Parameter.SEARCH_SPEED], self._axis[Parameter.SWITCH_SPEED])
                search_hz, leave_hz = (abs(self._rate_hz(speed)) for speed in speeds)
                self._motor.home(search_hz, leave_hz)
            case Search.STOP:
                self._motor.run(0.0)
            case Search.STATUS:
                return SUCCESS, int(self._motor.homing)
            case _:
                return WRONG_TYPE, 0
        return SUCCESS, 0

    def _rate_hz(self, velocity: int) -> float:
        """Return the motor's rate for the module's number; positive into the finger."""
        fastest = self._axis[Parameter.MAX_SPEED]
        return self._direction * min(max(velocity, -fastest), fastest) / self._scene.velocity_scale

    def _units(self, rate_hz: float) -> int:
        return round(rate_hz * self._scene.velocity_scale)


class EmulatedSerialLine:
    """Datagrams of 9 bytes on a pseudo-terminal."""

    def __init__(self, module: EmulatedTmclModule, port: PtyPort) -> None:
        self._module, self._port, self._datagrams = module, port, DatagramSplitter()
        self._waited_for = DescriptorSet([port.fileno()])

    def serve(self, wait_s: float) -> None:
        """Take the requests that come within `wait_s`, and send the answers that are due."""
        if self._waited_for.wait(round(wait_s * 1e9)):
            for request in self._datagrams.feed(self._port.read(), time.perf_counter_ns()):
                self._module.receive(request, time.perf_counter_ns())
        for reply in self._module.due_answers(time.perf_counter_ns()):
            self._port.write(reply)


class EmulatedCanLine:
    """CAN frames of 7 bytes to the module's identifier, answered with the host's identifier."""

    def __init__(self, module: EmulatedTmclModule, scene: TmclScene, bus: "can.BusABC") -> None:
        self._module, self._bus = module, bus
        self._address = bytes([scene.module])
        bus.set_filters([{"can_id": scene.module, "can_mask": 0x7FF, "extended": False}])

    def serve(self, wait_s: float) -> None:
        """Take the next request, if one comes within `wait_s`, and send the answers due."""
        import can

        frame = self._bus.recv(wait_s)
        # A bus that also delivers our own frames does so with the host's identifier.
        if frame is not None and len(frame.data) >= 7:
            request = self._address + bytes(frame.data[:7])
            self._module.receive(request + bytes([checksum(request)]), time.perf_counter_ns())
        for reply in self._module.due_answers(time.perf_counter_ns()):
            data, identifier = reply[1:8], reply[0]
            self._bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))
