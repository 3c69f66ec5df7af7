"""An emulated CiA 402 drive on any CAN bus, as a `canopen` LocalNode around a pure state machine.

Modelled are velocity modes, two homing methods, heartbeat, limits and the PDOs of our driver. Not
modelled: position and torque modes, other homing methods, arbitration and errors of the bus.
"""

import math
import time
from importlib.resources import files
from threading import RLock
from typing import Any

import can
import canopen

from pulse_drives.cia402.node import HEARTBEAT, QUICK_STOP_ON_ABORT, RPDO1, SYNC
from pulse_drives.cia402.state_machine import (
    HEARTBEAT_ERROR,
    HERE,
    HOMING_ATTAINED,
    HOMING_ERROR,
    NEGATIVE_SWITCH,
    POSITIVE_SWITCH,
    Controlword,
    Mode,
    State,
)
from pulse_drives.scene import Cia402Scene
from telepulse.emulators.motor import EmulatedMotor

ALL_MODES = (Mode.PROFILE_VELOCITY, Mode.CYCLIC_VELOCITY)
TPDO_S = 0.01
NOTIFIER_CYCLE_S = 0.1
LAST_SYNC_TYPE = 240
# Numbers of NMT states in a heartbeat.
STATE_NUMBERS = {"INITIALISING": 0, "STOPPED": 4, "OPERATIONAL": 5, "PRE-OPERATIONAL": 127}
# Objects whose values change without a write, and the attributes of the drive that they show.
_OBJECTS = {
    0x603F: "error_code",
    0x6041: "statusword",
    0x6061: "mode",
    0x6064: "position",
    0x606C: "velocity",
    0x60FD: "digital_inputs",
}
# State after a controlword.
_TRANSITIONS: dict[tuple[State, int], State] = {
    (State.SWITCH_ON_DISABLED, Controlword.SHUTDOWN): State.READY,
    (State.READY, Controlword.SWITCH_ON): State.SWITCHED_ON,
    (State.READY, Controlword.ENABLE): State.ENABLED,
    (State.SWITCHED_ON, Controlword.ENABLE): State.ENABLED,
    (State.SWITCHED_ON, Controlword.SHUTDOWN): State.READY,
    (State.ENABLED, Controlword.SHUTDOWN): State.READY,
    (State.ENABLED, Controlword.SWITCH_ON): State.SWITCHED_ON,
}
VOLTAGE_ENABLED = 0x10
ERROR_CODES = {"overtemperature": 0x4310, "following error": 0x8611, "stall": 0x7121}
# Bits of the digital inputs (0x60FD): a limit switch that is closed.
NEGATIVE_LIMIT, POSITIVE_LIMIT = 1, 2


class EmulatedCia402Drive:
    """The state machine around a motor: controlwords in, statuswords out. Pure.

    modes: the supported velocity modes; other modes except homing are ignored. error_code: 0
    without an error. abort_option: reaction to a missing heartbeat: 3 is a quick stop, 0 none, any
    other value a fault. homing: number of the method, and its two speeds in the drive's units.
    """

    def __init__(self, scene: Cia402Scene, motor: EmulatedMotor, modes: tuple[Mode, ...]) -> None:
        self._scene, self._motor, self._modes = scene, motor, modes
        self._direction = -1 if scene.inverted else 1
        self._control = self._homed = 0
        self._missed_heartbeat = False
        self.state = State.SWITCH_ON_DISABLED
        self.mode = self.error_code = 0
        self.abort_option = 1
        self.homing = (0, 0, 0)

    @property
    def statusword(self) -> int:
        """Statusword of the present state, with the homing bits in homing mode."""
        word: int = self.state.value[1]
        if self.state not in (State.FAULT, State.SWITCH_ON_DISABLED):
            word |= VOLTAGE_ENABLED
        if self.mode == Mode.HOMING and not self._motor.homing:
            word |= self._homed
        return word

    @property
    def position(self) -> int:
        """The position counter in the drive's units."""
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
        """Switch to a mode of operation, if the drive has it."""
        if mode in self._modes or mode == Mode.HOMING:
            self.mode = mode
            self._homed = 0

    def limit(self, least: int, most: int) -> None:
        """Set software position limits in the drive's units; equal ones: none."""
        ends = sorted(self._direction * end / self._scene.position_scale for end in (least, most))
        self._motor.limit(*(ends if least != most else (-math.inf, math.inf)))

    def advance(self, now_ns: int) -> None:
        """Advance to the present, with the effects of a motor fault and a missing heartbeat.

        A missing heartbeat is one event (CiA 301); monitoring starts again with the next one.
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
        """Apply a controlword with a target velocity in the drive's units."""
        before, self._control = self._control, word
        rising = word & ~before
        if self.state is State.FAULT:
            if rising & Controlword.RESET_FAULT:
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
            if rising & (Controlword.START_HOMING ^ Controlword.ENABLE):
                self._home()
        elif self.mode in self._modes:
            self._motor.run(self._direction * velocity / self._scene.velocity_scale)

    def _home(self) -> None:
        away = POSITIVE_SWITCH if self._direction < 0 else NEGATIVE_SWITCH
        method, *speeds = self.homing
        self._homed = HOMING_ATTAINED if method in (HERE, away) else HOMING_ERROR
        if method == HERE:
            self._motor.zero()
        elif method == away:
            self._motor.home(*(speed / self._scene.velocity_scale for speed in speeds))

    def _quick_stop(self) -> None:
        self._motor.run(0.0)
        self.state = State.QUICK_STOP

    def _fail(self, error_code: int) -> None:
        self._motor.run(0.0)
        self._homed = 0
        self.error_code = error_code
        self.state = State.FAULT


class EmulatedCia402Node:
    """Node that answers SDOs, takes RPDOs, and sends TPDOs when `poll` is called.

    silent: the node receives everything and sends nothing, as one with a broken transmitter.
    """

    def __init__(
        self,
        scene: Cia402Scene,
        motor: EmulatedMotor,
        bus: can.BusABC,
        modes: tuple[Mode, ...] = ALL_MODES,
    ) -> None:
        self.motor = motor
        self.drive = EmulatedCia402Drive(scene, motor, modes)
        self.silent = False
        self._supported = sum(mode.supported_bit for mode in (*modes, Mode.HOMING))
        self._lock = RLock()
        self._waiting: tuple[int, int] | None = None
        # True once the PDO mapping that the host wrote is in use, shortly after the NMT state.
        self._operational = False
        self._heartbeat_id = 0
        self._last_sent = (0, 0)
        self._sent_s = 0.0
        self._network = self.network(bus)
        self._network.NOTIFIER_CYCLE = NOTIFIER_CYCLE_S
        sheet = str(files("pulse_drives.cia402") / "cia402.eds")
        self._node = canopen.LocalNode(scene.node, sheet)
        # `poll` sends the heartbeat: the library's own is sent by a thread.
        self._node.nmt.start_heartbeat = lambda heartbeat_time_ms: None  # type: ignore[method-assign]
        self._own_heartbeat_id, self._beat_s = HEARTBEAT + scene.node, 0.0
        self._node.add_read_callback(self._on_read)  # type: ignore[no-untyped-call]
        self._node.add_write_callback(self._on_write)  # type: ignore[no-untyped-call]
        self._network[scene.node] = self._node
        self._network.subscribe(0, self._on_nmt)
        self._network.subscribe(SYNC, self._on_sync)
        self._network.subscribe(RPDO1 + scene.node, self._on_rpdo)
        self._network.connect()
        self._node.nmt.state = "INITIALISING"
        self._node.nmt.state = "PRE-OPERATIONAL"

    def network(self, bus: can.BusABC) -> canopen.Network:
        """Return the network of a bus."""
        return canopen.Network(bus)

    def poll(self) -> None:
        """Advance to the present and send due frames; call it every few milliseconds."""
        with self._lock:
            drive, now_s = self.drive, time.monotonic()
            drive.advance(time.perf_counter_ns())
            beat_s = self._stored(0x1017) * 1e-3
            if beat_s and now_s - self._beat_s >= beat_s and not self.silent:
                self._beat_s = now_s
                nmt_state = STATE_NUMBERS[self._node.nmt.state]
                self._network.send_message(self._own_heartbeat_id, bytes([nmt_state]))
            state = (drive.statusword, drive.error_code)
            due = now_s - self._sent_s >= TPDO_S or state != self._last_sent
            if due and self._operational and not self.silent:
                if state[1] and state[1] != self._last_sent[1]:
                    self._node.emcy.send(state[1])
                self._sent_s, self._last_sent = now_s, state
                for number in (1, 2):
                    pdo = self._node.tpdo[number]
                    for variable in pdo:
                        variable.raw = self._value(variable.index)
                    pdo.transmit()

    def close(self) -> None:
        """Leave the bus."""
        self._network.disconnect()

    def _value(self, index: int) -> int | None:
        """Return the present value of an object in `_OBJECTS`; None for any other."""
        name = _OBJECTS.get(index, "")
        value: int | None = self._supported if index == 0x6502 else getattr(self.drive, name, None)
        return value

    def _on_read(self, index: int, subindex: int, od: Any) -> int | None:
        if self.silent:
            raise canopen.SdoAbortedError(0x0504_0000)
        with self._lock:
            self.drive.advance(time.perf_counter_ns())
            return self._value(index)

    def _on_write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        value: int = od.decode_raw(data)
        with self._lock:
            self.drive.advance(time.perf_counter_ns())
            match index, subindex:
                case 0x6060, _:
                    self.drive.select(value)
                case 0x6007, _:
                    self.drive.abort_option = value
                case 0x1016, 1:
                    # Monitoring starts with the first heartbeat that is received.
                    self._heartbeat_id = HEARTBEAT + (value >> 16 & 0x7F)
                    self._network.subscribe(self._heartbeat_id, self._on_heartbeat)
                    self._heartbeat_ns = (value & 0xFFFF) * 1_000_000
                    self.motor.set_watchdog(0)

    def _on_heartbeat(self, can_id: int, _: bytearray, __: float) -> None:
        with self._lock:
            self.drive.advance(time.perf_counter_ns())
            if can_id == self._heartbeat_id and self._heartbeat_ns:
                self.motor.set_watchdog(self._heartbeat_ns)

    def _on_nmt(self, _: int, __: bytearray, ___: float) -> None:
        """Read the PDOs' configuration when the node becomes operational."""
        with self._lock:
            self._operational = self._node.nmt.state == "OPERATIONAL"
            if not self._operational:
                return
            for pdo in (self._node.rpdo[1], self._node.tpdo[1], self._node.tpdo[2]):
                pdo.read()
                # A bus may also deliver our own frames.
                self._network.unsubscribe(pdo.cob_id, pdo.on_message)

    def _on_rpdo(self, _: int, data: bytearray, __: float) -> None:
        pdo = self._node.rpdo[1]
        if not self._operational or len(data) != len(pdo.data):
            return
        pdo.data = data
        command = (int(pdo[0x6040].raw), int(pdo[0x60FF].raw))
        with self._lock:
            self._waiting = command
        if pdo.trans_type > LAST_SYNC_TYPE:
            self._on_sync(SYNC, bytearray(), 0.0)

    def _on_sync(self, _: int, __: bytearray, ___: float) -> None:
        with self._lock:
            self.drive.advance(time.perf_counter_ns())
            if self._waiting is not None:
                stored = self._stored
                self.drive.homing = stored(0x6098), stored(0x6099, 1), stored(0x6099, 2)
                self.drive.limit(stored(0x607D, 1), stored(0x607D, 2))
                self.drive.control(*self._waiting)
                self._waiting = None

    def _stored(self, index: int, subindex: int = 0) -> int:
        """Return the value written to an object; 0 before any."""
        written = self._node.data_store.get(index, {}).get(subindex, b"")
        return int.from_bytes(written, "little", signed=True)
