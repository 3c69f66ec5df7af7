"""A TMCL module and one of its motors: configuration, homing, commands and reports, by requests.

The numbers of instructions and parameters are those of the firmware manuals.
"""

import math
import time
from collections import Counter
from collections.abc import Callable
from enum import IntEnum, IntFlag

from protocol.errors import DriveError
from protocol.faults import FaultKind
from pulse_drives.axis import Axis
from pulse_drives.drive import bound_search
from pulse_drives.scene import TmclScene

TRIES = 3
# Time for repeating a request; a CANopen drive has the same time for an answer.
RETRY_FOR_S = 0.5
# Kinds of DriveError after which a repeated request may succeed.
TRANSIENT = (FaultKind.NO_ANSWER, FaultKind.GARBLED, FaultKind.WRONG_DEVICE)
SEARCH_POLL_S = 0.01
POLLS_PER_WATCHDOG = 4
# Polls of a motor that comes to rest, enough at any line's bit rate.
REST_POLLS = 100


class Command(IntEnum):
    """Instructions."""

    ROTATE_RIGHT = 1
    ROTATE_LEFT = 2
    MOTOR_STOP = 3
    SET_AXIS = 5
    GET_AXIS = 6
    SET_GLOBAL = 9
    GET_GLOBAL = 10
    REFERENCE_SEARCH = 13
    FIRMWARE_VERSION = 136


class Parameter(IntEnum):
    """Axis parameters."""

    ACTUAL_POSITION = 1
    ACTUAL_SPEED = 3
    MAX_SPEED = 4
    MAX_ACCELERATION = 5
    RIGHT_SWITCH_STATE = 10
    LEFT_SWITCH_STATE = 11
    MICROSTEPS = 140
    SEARCH_MODE = 193
    SEARCH_SPEED = 194
    SWITCH_SPEED = 195
    ERROR_FLAGS = 207
    DRIVER_FLAGS = 208


class Global(IntEnum):
    """Global parameters of bank 0: time without a request, in ms, until the motor is stopped."""

    SERIAL_HEARTBEAT = 68
    CAN_HEARTBEAT = 82


class Search(IntEnum):
    """Types of the reference search's instruction."""

    START = 0
    STOP = 1
    STATUS = 2


# Modes of the reference search: to the left switch alone, and to the right one instead.
LEFT_SWITCH, RIGHT_SWITCH = 1, 65


class ErrorFlag(IntFlag):
    """Reason for which the module stopped the motor (axis parameter 207)."""

    STALL = 1
    DEVIATION = 2


class DriverFlag(IntFlag):
    """Errors of the driver chip (axis parameter 208) that stop the motor: bits of a TMC26x."""

    OVERTEMPERATURE = 2
    SHORT_A = 8
    SHORT_B = 16


class TmclModule:
    """One motor of a module and its last reports; see `DriveDevice`.

    Attributes
    ----------
    position_ns
        Time of the last reported position on the monotonic clock.
    received_ns
        Time of the module's last answer.
    switch, switch_closed, switch_ns
        Axis parameter of the home switch, its last value, and the time of that value.
    switch_requested
        True while the home switch is to be read.
    """

    def __init__(self, scene: TmclScene, axis: Axis, counts: Counter[str]) -> None:
        """Open the line. Raises DriveError."""
        try:
            from pulse_drives.tmcl.line import TmclLine
        except ImportError as error:
            raise DriveError(
                FaultKind.LIBRARY_MISSING,
                f"PyTrinamic is missing ({error}); pip install 'telepulse[drives]'",
            ) from None
        self._scene = scene
        self._axis = axis
        self._line = TmclLine(scene, counts)
        self.position_m, self.position_ns = axis.lowest_m, 0
        self.speed_m_per_s = 0.0
        self.received_ns = 0
        self.switch = (
            Parameter.RIGHT_SWITCH_STATE if scene.inverted else Parameter.LEFT_SWITCH_STATE
        )
        self.switch_requested = self.switch_closed = False
        self.switch_ns = 0

    def configure(self) -> None:
        """See `DriveDevice.configure`; the motor is stopped."""
        scene, axis = self._scene, self._axis
        self._retry(Command.FIRMWARE_VERSION, 1)
        self._retry(Command.MOTOR_STOP)
        acceleration = axis.max_acceleration_m_per_s2 / axis.units.step_m
        self._set(Parameter.MAX_SPEED, abs(axis.units.velocity(axis.max_speed_m_per_s)))
        self._set(Parameter.MAX_ACCELERATION, round(acceleration * scene.acceleration_scale))
        self._set(Parameter.MICROSTEPS, round(math.log2(axis.microsteps)))
        # Reading clears the flags of an earlier run; those of a present error appear again.
        self._retry(Command.GET_AXIS, Parameter.ERROR_FLAGS)
        self.read(Parameter.ERROR_FLAGS)
        self.read(Parameter.DRIVER_FLAGS)
        self.read(Parameter.ACTUAL_POSITION)

    def home(self, guard: Callable[[], None]) -> None:
        """See `DriveDevice.home`."""
        scene, axis = self._scene, self._axis
        if scene.homing == "none" and scene.homing_method is None:
            self._set(Parameter.ACTUAL_POSITION, 0)
        else:
            switch = RIGHT_SWITCH if scene.inverted else LEFT_SWITCH
            speed = abs(axis.units.velocity(scene.homing_speed_m_per_s))
            self._set(Parameter.SEARCH_MODE, scene.homing_method or switch)
            self._set(Parameter.SEARCH_SPEED, speed)
            self._set(Parameter.SWITCH_SPEED, max(1, speed // 4))
            # Read before the search, whose travel counts from here.
            self.read(Parameter.ACTUAL_POSITION)
            # A search towards the finger must not outlast its host, which alone bounds it.
            self.arm_watchdog()
            self._retry(Command.REFERENCE_SEARCH, Search.START)
            try:
                self._await_home(time.monotonic() + axis.search_s, guard)
            except DriveError as error:
                if error.kind in (FaultKind.NOT_HOMED, FaultKind.WRONG_WAY):
                    self._retry(Command.REFERENCE_SEARCH, Search.STOP)
                raise
        self.read(Parameter.ACTUAL_POSITION)

    def _await_home(self, deadline_s: float, guard: Callable[[], None]) -> None:
        began_m = self.position_m
        while self._retry(Command.REFERENCE_SEARCH, Search.STATUS):
            guard()
            self.read(Parameter.ACTUAL_POSITION)
            bound_search(self._axis, began_m, self.position_m)
            self.read(Parameter.ERROR_FLAGS)
            if time.monotonic() > deadline_s:
                text = f"no home switch within {self._axis.search_s:.0f} s"
                raise DriveError(FaultKind.NOT_HOMED, text)
            time.sleep(min(SEARCH_POLL_S, self._scene.watchdog_ns * 1e-9 / POLLS_PER_WATCHDOG))

    def arm_watchdog(self) -> None:
        """See `DriveDevice.arm_watchdog`."""
        watchdog_ms = round(self._scene.watchdog_ns / 1e6)
        on_serial = self._scene.port is not None
        heartbeat = Global.SERIAL_HEARTBEAT if on_serial else Global.CAN_HEARTBEAT
        self._retry(Command.SET_GLOBAL, heartbeat, watchdog_ms, bank=0)
        taken_ms = self._retry(Command.GET_GLOBAL, heartbeat, bank=0)
        if taken_ms != watchdog_ms:
            text = f"the module's heartbeat is {taken_ms} ms, not {watchdog_ms}"
            raise DriveError(FaultKind.NO_WATCHDOG, text)

    def rotate(self, velocity: int) -> None:
        """Run at a velocity in the module's units."""
        self._line.request(Command.ROTATE_RIGHT, 0, self._scene.motor, velocity)
        self.received_ns = time.perf_counter_ns()

    def read(self, parameter: Parameter) -> None:
        """Read an axis parameter. A DriveError of kind "fault" names the cause of a stop."""
        number = self._line.request(Command.GET_AXIS, parameter, self._scene.motor)
        self.received_ns = time.perf_counter_ns()
        match parameter:
            case Parameter.ACTUAL_POSITION:
                self.position_m = self._axis.units.position_m(number)
                self.position_ns = self.received_ns
            case Parameter.LEFT_SWITCH_STATE | Parameter.RIGHT_SWITCH_STATE:
                self.switch_closed, self.switch_ns = bool(number), self.received_ns
            case Parameter.ACTUAL_SPEED:
                self.speed_m_per_s = self._axis.units.speed_m_per_s(number)
            case Parameter.ERROR_FLAGS | Parameter.DRIVER_FLAGS:
                kind = ErrorFlag if parameter is Parameter.ERROR_FLAGS else DriverFlag
                names = [flag.name for flag in kind if flag.name and number & flag]
                if names:
                    words = ", ".join(names).lower().replace("_", " ")
                    raise DriveError(FaultKind.DRIVE_FAULT, words)

    def end_search(self) -> None:
        """Stop the motor as well as the line permits, and read its position. Never raises.

        If requests do not reach the module, its heartbeat stops the motor.
        """
        missed = 0
        for _ in range(REST_POLLS):
            try:
                self._line.request(Command.MOTOR_STOP, 0, self._scene.motor)
                self.read(Parameter.ACTUAL_SPEED)
                self.read(Parameter.ACTUAL_POSITION)
            except DriveError as error:
                missed += 1
                if error.kind not in TRANSIENT or missed == TRIES:
                    return
            if not self.speed_m_per_s:
                return

    def close(self) -> None:
        """See `DriveDevice.close`."""
        self.end_search()
        self._line.close()

    def _set(self, parameter: Parameter, value: int) -> None:
        self._retry(Command.SET_AXIS, parameter, value)

    def _retry(self, command: int, kind: int = 0, value: int = 0, bank: int | None = None) -> int:
        """Repeat a request for up to half a second; it goes to the motor, or to `bank` if given."""
        motor = self._scene.motor if bank is None else bank
        until_s = time.monotonic() + RETRY_FOR_S
        while True:
            try:
                return self._line.request(command, kind, motor, value)
            except DriveError as error:
                if error.kind not in TRANSIENT or time.monotonic() > until_s:
                    raise
