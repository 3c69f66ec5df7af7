"""An emulated TMCL module: requests in, replies out, as its firmware would. Pure.

Lines to an emulated TMCL module: a pseudo-terminal, or a CAN bus.
"""

import math
import select
import struct
import time
from typing import Literal

import can

from display_node.drives.scene import TmclScene
from display_node.drives.tmcl.parameters import (
    SUCCESS,
    Command,
    DriverFlag,
    ErrorFlag,
    Global,
    Parameter,
    Search,
)
from telepulse.emulators.motor import EmulatedMotor
from telepulse.emulators.pty_port import PtyPort

DATAGRAM = struct.Struct(">BBBBiB")
WRONG_CHECKSUM, INVALID_COMMAND, WRONG_TYPE, INVALID_VALUE = 1, 2, 3, 4
# The low 16 bits are version 1.0, the high ones the module's number; there is no 9999.
VERSION = 9999 << 16 | 1 << 8
# A pause this long in the middle of a datagram, and the next byte begins a new one.
PAUSE_NS = 5_000_000
# Axis parameters: the state of each limit switch, 1 for closed.
RIGHT_SWITCH_STATE, LEFT_SWITCH_STATE = 10, 11

AnswerMode = Literal["right", "wrong", "garbled", "late", "none"]


def checksum(data: bytes) -> int:
    """The last byte of a datagram: the sum of those before it."""
    return sum(data) & 0xFF


class DatagramSplitter:
    """Cuts the bytes of a serial line into requests."""

    def __init__(self) -> None:
        self._bytes = b""
        self._heard_ns = 0

    def feed(self, data: bytes, now_ns: int) -> list[bytes]:
        """The whole requests among these bytes and what was left before them."""
        if now_ns - self._heard_ns > PAUSE_NS:
            self._bytes = b""
        self._heard_ns = now_ns
        self._bytes += data
        whole = len(self._bytes) // DATAGRAM.size * DATAGRAM.size
        requests, self._bytes = self._bytes[:whole], self._bytes[whole:]
        return [requests[i : i + DATAGRAM.size] for i in range(0, whole, DATAGRAM.size)]


class EmulatedTmclModule:
    """Answers requests and moves the motor.

    answers: how requests are answered, for trying what a driver makes of it; late_s: how late,
    where that is late. lies: the motor's.
    """

    def __init__(self, scene: TmclScene, motor: EmulatedMotor) -> None:
        self._scene = scene
        self._motor = motor
        self.lies = motor.lies
        self._direction = -1 if scene.inverted else 1
        self._axis: dict[int, int] = {
            Parameter.SEARCH_MODE: 1,
            Parameter.SEARCH_SPEED: self._units(5e3),
            Parameter.SWITCH_SPEED: self._units(1e3),
            Parameter.MAX_SPEED: self._units(1e6),
            Parameter.MAX_ACCELERATION: 0,
            Parameter.MICROSTEPS: 4,
        }
        self._global = {int(Global.SERIAL_HEARTBEAT): 0, int(Global.CAN_HEARTBEAT): 0}
        self._errors = ErrorFlag(0)
        self.answers: AnswerMode = "right"
        self.late_s = 0.03

    def reply(self, request: bytes, now_ns: int) -> bytes:
        """The 9 bytes of reply to 9 bytes of request; none to what is for another module."""
        address, command, kind, motor, value, check = DATAGRAM.unpack(request)
        self._motor.advance(now_ns)
        if address != self._scene.module or self.answers == "none":
            return b""
        if checksum(request[:-1]) != check:
            status = WRONG_CHECKSUM
        else:
            self._motor.feed()
            status, value = self._carry_out(command, kind, motor, value)
        return self._datagram(status, command, value)

    def _datagram(self, status: int, command: int, value: int) -> bytes:
        if self.answers == "wrong":
            command ^= 0x40
        body = DATAGRAM.pack(self._scene.host, self._scene.module, status, command, value, 0)[:-1]
        check = checksum(body) + (self.answers == "garbled")
        return body + bytes([check & 0xFF])

    def _carry_out(self, command: int, kind: int, motor: int, value: int) -> tuple[int, int]:
        """Status and value of the reply."""
        for_motor = command not in (
            Command.SET_GLOBAL,
            Command.GET_GLOBAL,
            Command.FIRMWARE_VERSION,
        )
        if for_motor and motor != self._scene.motor:
            return INVALID_VALUE, value
        match command:
            case Command.ROTATE_RIGHT | Command.ROTATE_LEFT:
                sign = 1 if command == Command.ROTATE_RIGHT else -1
                self._motor.run(self._rate_hz(sign * value))
            case Command.MOTOR_STOP:
                self._motor.run(0.0)
            case Command.SET_AXIS:
                return self._set_axis(kind, value), value
            case Command.GET_AXIS:
                return self._get_axis(kind)
            case Command.SET_GLOBAL | Command.GET_GLOBAL:
                return self._global_parameter(command, kind, motor, value)
            case Command.REFERENCE_SEARCH:
                return self._search(kind)
            case Command.FIRMWARE_VERSION:
                return SUCCESS, VERSION
            case _:
                return INVALID_COMMAND, value
        return SUCCESS, value

    def _set_axis(self, kind: int, value: int) -> int:
        if kind == Parameter.ACTUAL_POSITION:
            if value:
                return INVALID_VALUE
            self._motor.zero()
            return SUCCESS
        if kind not in self._axis:
            return WRONG_TYPE
        if value < 0 or (kind == Parameter.MICROSTEPS and value > 8):
            return INVALID_VALUE
        self._axis[kind] = value
        return SUCCESS

    def _get_axis(self, kind: int) -> tuple[int, int]:
        motor = self._motor
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
            case _ if kind in (RIGHT_SWITCH_STATE, LEFT_SWITCH_STATE):
                home = RIGHT_SWITCH_STATE if self._scene.inverted else LEFT_SWITCH_STATE
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
                self._motor.watch(value * 1_000_000)
        return SUCCESS, self._global[kind]

    def _search(self, kind: int) -> tuple[int, int]:
        match kind:
            case Search.START:
                if self._axis[Parameter.SEARCH_MODE] & 64 != (64 if self._scene.inverted else 0):
                    # The switch on the other side: there is none.
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
        """The motor's rate for the module's number; positive into the finger."""
        rate_hz = velocity / self._scene.velocity_scale
        fastest_hz = self._axis[Parameter.MAX_SPEED] / self._scene.velocity_scale
        return self._direction * math.copysign(min(abs(rate_hz), fastest_hz), rate_hz)

    def _units(self, rate_hz: float) -> int:
        return round(rate_hz * self._scene.velocity_scale)


class EmulatedSerialLine:
    """Datagrams of 9 bytes on a pseudo-terminal."""

    def __init__(self, module: EmulatedTmclModule, port: PtyPort) -> None:
        self._module = module
        self._port = port
        self._datagrams = DatagramSplitter()

    def serve(self, wait_s: float) -> None:
        """Answer what has come, waiting so long for it at most."""
        readable, _, _ = select.select([self._port], [], [], wait_s)
        if readable:
            for request in self._datagrams.feed(self._port.read(), time.monotonic_ns()):
                _answer(self._module, request)
        for reply in self._module.lies.due(time.monotonic_ns()):
            self._port.write(reply)

    def close(self) -> None:
        """Unplug."""
        self._port.close()


class EmulatedCanLine:
    """Frames of 7 bytes to the module's identifier, answered from the host's."""

    def __init__(self, module: EmulatedTmclModule, scene: TmclScene, bus: can.BusABC) -> None:
        self._module = module
        self._address = bytes([scene.module])
        self._bus = bus
        bus.set_filters([{"can_id": scene.module, "can_mask": 0x7FF, "extended": False}])

    def serve(self, wait_s: float) -> None:
        """Answer the next request, waiting so long for it at most."""
        frame = self._bus.recv(wait_s)
        # A bus that brings us what we send ourselves does so from the host's identifier.
        if frame is not None and len(frame.data) >= 7:
            request = self._address + bytes(frame.data[:7])
            _answer(self._module, request + bytes([checksum(request)]))
        for reply in self._module.lies.due(time.monotonic_ns()):
            data, identifier = reply[1:8], reply[0]
            self._bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


def _answer(module: EmulatedTmclModule, request: bytes) -> None:
    """Leave the reply to a request in the module's lies, which send it."""
    reply = module.reply(request, time.monotonic_ns())
    if module.answers == "late":
        time.sleep(module.late_s)
    if reply:
        module.lies.answer(reply, time.monotonic_ns())
