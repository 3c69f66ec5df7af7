"""An emulated CiA 402 drive, without the bus: controlwords in, statuswords out. Pure."""

import math

from display_node.drives.cia402.states import (
    HERE,
    HOMING_ATTAINED,
    HOMING_ERROR,
    NEGATIVE_SWITCH,
    POSITIVE_SWITCH,
    Control,
    Mode,
    State,
)
from display_node.drives.scene import Cia402Scene
from telepulse.emulators.motor import EmulatedMotor

# Where each controlword leads from a state.
_TRANSITIONS: dict[tuple[State, int], State] = {
    (State.SWITCH_ON_DISABLED, Control.SHUTDOWN): State.READY,
    (State.READY, Control.SWITCH_ON): State.SWITCHED_ON,
    (State.READY, Control.ENABLE): State.ENABLED,
    (State.SWITCHED_ON, Control.ENABLE): State.ENABLED,
    (State.SWITCHED_ON, Control.SHUTDOWN): State.READY,
    (State.ENABLED, Control.SHUTDOWN): State.READY,
    (State.ENABLED, Control.SWITCH_ON): State.SWITCHED_ON,
}
VOLTAGE_ENABLED = 0x10
ERROR_CODES = {"overtemperature": 0x4310, "following error": 0x8611, "stall": 0x7121}
HEARTBEAT_ERROR = 0x8130
QUICK_STOP_ON_ABORT = 3
# Bits of the digital inputs (0x60FD): a limit switch that is closed.
NEGATIVE_LIMIT, POSITIVE_LIMIT = 1, 2


class EmulatedDrive:
    """The state machine around a motor.

    error_code: what is wrong, 0 for nothing. modes: the supported ones; a mode that is not
    among them is never shown as taken. abort_option: what happens without a heartbeat: 3 is a
    quick stop, 0 nothing, anything else a fault.
    """

    def __init__(self, scene: Cia402Scene, motor: EmulatedMotor, modes: tuple[Mode, ...]) -> None:
        self._scene = scene
        self._motor = motor
        self._direction = -1 if scene.inverted else 1
        self._modes = modes
        self._control = 0
        self._homed: int = 0
        self._missed_heartbeat = False
        self._method = self._search = self._leave = 0
        self.state = State.SWITCH_ON_DISABLED
        self.mode = 0
        self.error_code = 0
        self.abort_option = 1

    @property
    def statusword(self) -> int:
        """Statusword of the present state, with the homing bits in that mode."""
        word: int = self.state.value[1]
        if self.state not in (State.FAULT, State.SWITCH_ON_DISABLED):
            word |= VOLTAGE_ENABLED
        if self.mode == Mode.HOMING and not self._motor.homing:
            word |= self._homed
        return word

    @property
    def position(self) -> int:
        """The counter in the drive's units."""
        return round(self._direction * self._motor.position_steps * self._scene.position_scale)

    @property
    def velocity(self) -> int:
        """The motor's speed in the drive's units."""
        return round(self._direction * self._motor.counter_hz * self._scene.velocity_scale)

    @property
    def digital_inputs(self) -> int:
        """State of the limit switches: the home switch is one of them, away from the finger."""
        home = POSITIVE_LIMIT if self._direction < 0 else NEGATIVE_LIMIT
        return home if self._motor.at_switch else 0

    def select(self, mode: int) -> None:
        """Take a mode of operation, if the drive has it."""
        if mode in self._modes or mode == Mode.HOMING:
            self.mode = mode
            self._homed = 0

    def search_by(self, method: int, search: int, leave: int) -> None:
        """Set the homing method by its number, and the speeds in the drive's units."""
        self._method, self._search, self._leave = method, search, leave

    def limit(self, least: int, most: int) -> None:
        """Software position limits in the drive's units; both 0: none."""
        ends = sorted(self._direction * end / self._scene.position_scale for end in (least, most))
        self._motor.limit(*(ends if least != most else (-math.inf, math.inf)))

    def advance(self, now_ns: int) -> None:
        """Come to the present: what the motor and the missing heartbeat do by themselves.

        A missing heartbeat is one event (CiA 301): it is monitored again from the next one on.
        """
        self._motor.advance(now_ns)
        missed = self._motor.tripped and not self._missed_heartbeat
        self._missed_heartbeat = self._motor.tripped
        if self._motor.fault and self.state is not State.FAULT:
            self._fail(ERROR_CODES[self._motor.fault])
        elif missed and self.state is State.ENABLED and self.abort_option:
            if self.abort_option == QUICK_STOP_ON_ABORT:
                self.error_code = HEARTBEAT_ERROR
                self._quick_stop()
            else:
                self._fail(HEARTBEAT_ERROR)
        elif self.state is State.QUICK_STOP and self._motor.rate_hz == 0.0:
            self.state = State.SWITCH_ON_DISABLED

    def control(self, word: int, velocity: int) -> None:
        """A controlword with a target velocity in the drive's units."""
        before, self._control = self._control, word
        if self.state is State.FAULT:
            if word & ~before & Control.RESET_FAULT:
                self._motor.reset()
                self.error_code = 0
                self.state = State.SWITCH_ON_DISABLED
            return
        if not word & 0x02:
            self.state = State.SWITCH_ON_DISABLED
        elif not word & 0x04:
            if self.state is State.ENABLED:
                self._quick_stop()
        else:
            self.state = _TRANSITIONS.get((self.state, word & 0x0F), self.state)
        if self.state is not State.ENABLED:
            self._motor.run(0.0)
        elif self.mode == Mode.HOMING:
            if word & ~before & (Control.START_HOMING ^ Control.ENABLE):
                self._home()
        elif self.mode in self._modes:
            self._motor.run(self._direction * velocity / self._scene.velocity_scale)

    def _home(self) -> None:
        away = POSITIVE_SWITCH if self._direction < 0 else NEGATIVE_SWITCH
        if self._method == HERE:
            self._motor.zero()
        elif self._method == away:
            speeds = (self._search, self._leave)
            self._motor.home(*(speed / self._scene.velocity_scale for speed in speeds))
        else:
            self._homed = HOMING_ERROR
            return
        self._homed = HOMING_ATTAINED

    def _quick_stop(self) -> None:
        self._motor.run(0.0)
        self.state = State.QUICK_STOP

    def _fail(self, error_code: int) -> None:
        self._motor.run(0.0)
        self.error_code = error_code
        self.state = State.FAULT
