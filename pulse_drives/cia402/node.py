"""A CiA 402 drive on its bus: configured by SDO, commanded by RPDO, reporting by TPDO."""

import logging
import math
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.resources import files
from typing import Any

from protocol.errors import DriveError
from protocol.faults import Fault, FaultKind, Part, internal_fault
from pulse_drives.axis import Axis
from pulse_drives.cia402.state_machine import (
    ERRORS,
    HERE,
    HOMING_ATTAINED,
    HOMING_ERROR,
    NEGATIVE_SWITCH,
    POSITIVE_SWITCH,
    Controlword,
    Mode,
    State,
    state_of,
    towards_enabled,
)
from pulse_drives.drive import bound_search
from pulse_drives.scene import Cia402Scene, discard_spoilt_line, is_noise, open_bus
from pulse_drives.supervisor import NO_ANSWER, Silence, TimeoutLock

NMT, SYNC = 0x00, 0x80
EMERGENCY, TPDO1, TPDO2, RPDO1, HEARTBEAT = 0x80, 0x180, 0x280, 0x200, 0x700
BY_SYNC, BY_EVENT = 1, 255
# Number of heartbeats in the drive's watchdog time.
BEATS = 4
# Greatest time between two TPDOs, so that a silent drive differs from one at standstill.
EVENT_MS = 10
# Period of the drive's heartbeat, by which a drive that leaves its NMT state is told from one that
# is silent, before any watchdog's time.
PRODUCER_MS = 20
OPERATIONAL = 5
NMT_STATES = {0: "initialising", 4: "stopped", OPERATIONAL: "operational", 127: "pre-operational"}
# State after an NMT command of a master.
NMT_COMMANDS = {1: OPERATIONAL, 2: 4, 128: 127, 129: 0, 130: 0}
Listener = Callable[[int, bytearray, float], None]
GARBLED: Silence = (FaultKind.GARBLED, "garbled: no plausible TPDO")
ENABLE_WITHIN_S = 2.0
SDO_TIMEOUT_S = 0.5
POLL_S = 0.002
# Pause after a bus error: a disconnected bus fails at once on every read.
LOST_PAUSE_S = 0.05
QUICK_STOP_ON_ABORT = 3
COMMAND = STATE_TPDO = struct.Struct("<Hi")
SPEED_TPDO = struct.Struct("<iH")
# Reports beyond this multiple of the highest speed or, after homing, of the travel are rejected.
IMPLAUSIBLE = 10

# Errors are raised or counted here, so canopen's log is not shown unless a program requests it.
logging.getLogger("canopen").addHandler(logging.NullHandler())


class Cia402Node:
    """One drive and its last reports. Methods raise DriveError.

    Attributes
    ----------
    mode
        Velocity mode in which the drive takes commands.
    statusword, state, error_code
        Last values reported by TPDO, as are position and speed; error_code also by emergency.
    received_ns
        Time of the last plausible state report (TPDO1) on the monotonic clock.
    counts
        "malformed": TPDOs, emergencies and heartbeats of wrong length. "implausible": TPDOs whose
        values are not used. "garbled": frames that a CAN adapter corrupted. "not disabled", with
        the kind of error, and "not closed": a drive and a bus that could not be shut down.
    """

    def __init__(self, scene: Cia402Scene, axis: Axis, counts: Counter[str]) -> None:
        try:
            import can
            import canopen
        except ImportError as error:
            raise DriveError(
                FaultKind.LIBRARY_MISSING,
                f"canopen is missing ({error}); pip install 'telepulse[drives]'",
            ) from None
        self._name = f"node {scene.node} on {scene.interface} {scene.channel}"
        self._scene = scene
        self._axis = axis
        self.counts = counts
        self.statusword = self.error_code = 0
        self.state = State.NOT_READY
        self.position_m = axis.lowest_m
        self.speed_m_per_s = 0.0
        self.received_ns = self._implausible_ns = 0
        # Before homing the origin of the position is arbitrary, so every position is plausible.
        self._implausible_m = math.inf
        self.mode = Mode.CYCLIC_VELOCITY
        # Error after which the bus cannot be read any more.
        self._lost: Exception | None = None
        self._internal: Fault | None = None
        self._nmt_state = self._beat_state = OPERATIONAL
        # Created once, since creating a message costs a third of sending it.
        self._command, self._sync, self._heartbeat, self._start = (
            can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
            for identifier, data in (
                (RPDO1 + scene.node, bytes(COMMAND.size)),
                (SYNC, b""),
                (HEARTBEAT + scene.host, bytes([OPERATIONAL])),
                (NMT, bytes([1, scene.node])),
            )
        )
        self._bus = open_bus(scene)
        with ExitStack() as opened:
            opened.callback(self._bus.shutdown)
            self._network = canopen.Network(self._bus)
            opened.pop_all()
            opened.callback(self._leave)
            self._join()
            opened.pop_all()

    def _join(self) -> None:
        """Build the network's node, and read the bus from now on."""
        import canopen

        scene = self._scene
        self._network.NOTIFIER_CYCLE = 0.1
        # canopen's own threads send as well.
        self._sending = TimeoutLock(self._network.send_lock)
        sheet = str(files("pulse_drives.cia402") / "cia402.eds")
        self._node = canopen.RemoteNode(scene.node, sheet)
        self._node.sdo.RESPONSE_TIMEOUT = SDO_TIMEOUT_S
        self._network.add_node(self._node)
        # The library's own listeners fail at a truncated message, and store all emergencies.
        self._network.unsubscribe(EMERGENCY + scene.node, self._node.emcy.on_emcy)
        self._network.unsubscribe(HEARTBEAT + scene.node, self._node.nmt.on_heartbeat)
        self._network.unsubscribe(NMT, self._node.nmt.on_command)
        for identifier, take in (
            (TPDO1 + scene.node, self._on_state),
            (TPDO2 + scene.node, self._on_speed),
            (EMERGENCY + scene.node, self._on_emergency),
            (HEARTBEAT + scene.node, self._on_heartbeat),
            (NMT, self._on_nmt_command),
        ):
            self._network.subscribe(identifier, partial(self._take, take))
        # Without this handler the network's thread would end with a traceback.
        self._network.listeners[0].on_error = self._on_bus_error  # type: ignore[method-assign]
        self._network.connect()

    @property
    def error(self) -> str:
        """Name of the drive's last error code."""
        return ERRORS.get(self.error_code, f"error 0x{self.error_code:04X}")

    @property
    def silence(self) -> Silence:
        """Fault to report when no plausible TPDO has arrived for too long."""
        return GARBLED if self._implausible_ns > self.received_ns else NO_ANSWER

    def fault(self, now_ns: int) -> Fault | None:
        """Return why the drive cannot be used; None while it reports that operation is enabled."""
        if self._internal is not None:
            return self._internal
        if self._nmt_state != OPERATIONAL:
            cause = f"left its state: it is {NMT_STATES[self._nmt_state]} (NMT)"
            return Fault(FaultKind.LEFT_STATE, Part.DRIVE, cause, now_ns)
        if self.state is State.ENABLED:
            return None
        if self.state in (State.FAULT, State.REACTING):
            return Fault(FaultKind.DRIVE_FAULT, Part.DRIVE, f"fault: {self.error}", now_ns)
        cause = f"left its state: it is {self.state.text}, {self.error}"
        return Fault(FaultKind.LEFT_STATE, Part.DRIVE, cause, now_ns)

    def start_again(self) -> None:
        """Command the drive to be operational, if it is not, so that it takes speeds."""
        if self._nmt_state != OPERATIONAL:
            self._send(self._start)

    def configure(self) -> None:
        """See `DriveDevice.configure`: set profile, PDOs, limits and mode; enable operation."""
        scene = self._scene
        self._node.nmt.state = "PRE-OPERATIONAL"
        profile = self.read(0x1000) & 0xFFFF
        if profile != 402:
            raise DriveError(FaultKind.NOT_CIA402, f"{self._name} has profile {profile}, not 402")
        supported = self.read(0x6502)
        modes = {"cyclic": Mode.CYCLIC_VELOCITY, "profile": Mode.PROFILE_VELOCITY}
        wanted = modes.values() if scene.mode == "auto" else [modes[scene.mode]]
        fitting = [mode for mode in wanted if supported & mode.supported_bit]
        if not fitting:
            text = f"{self._name} has no velocity mode that fits mode = {scene.mode!r}"
            raise DriveError(FaultKind.NO_SPEED_MODE, f"{text} (0x6502 is 0x{supported:X})")
        self.mode = fitting[0]
        by_sync = self.mode is Mode.CYCLIC_VELOCITY
        self._map(self._node.rpdo[1], (0x6040, 0x60FF), BY_SYNC if by_sync else BY_EVENT)
        self._map(self._node.tpdo[1], (0x6041, 0x6064), BY_EVENT)
        self._map(self._node.tpdo[2], (0x606C, 0x603F), BY_EVENT)
        for index in (0x6083, 0x6084, 0x6085):
            self.write_optional(index, 0, self._acceleration)
        self.write_optional(0x60C2, 1, min(round(scene.period_ns / 1e5), 255))
        self.write_optional(0x60C2, 2, -4)
        self.write_optional(0x1017, 0, PRODUCER_MS)
        self._node.nmt.state = "OPERATIONAL"
        self._nmt_state = self._beat_state = OPERATIONAL
        self._select(self.mode)
        control = Controlword.DISABLE_VOLTAGE
        deadline_s = time.monotonic() + ENABLE_WITHIN_S
        while not self.received_ns or self.state is not State.ENABLED:
            if time.monotonic() > deadline_s:
                state_text = self.state.text if self.received_ns else "it sends no TPDO"
                raise DriveError(FaultKind.NOT_ENABLED, f"still {state_text}, {self.error}")
            control = towards_enabled(self.state, control)
            self.command(control, 0)
            time.sleep(POLL_S)

    def home(self, guard: Callable[[], None]) -> None:
        """See `DriveDevice.home`; then set the drive's own soft limits."""
        scene, axis = self._scene, self._axis
        switch = POSITIVE_SWITCH if scene.inverted else NEGATIVE_SWITCH
        method = scene.homing_method
        if method is None:
            method = switch if scene.homing == "switch" else HERE
        speed = abs(axis.units.velocity(scene.homing_speed_m_per_s))
        self.write(0x6098, 0, method)
        self.write_optional(0x6099, 1, speed)
        self.write_optional(0x6099, 2, max(1, speed // 4))
        self.write_optional(0x609A, 0, self._acceleration)
        self._select(Mode.HOMING)
        self.command(Controlword.ENABLE, 0)
        # A search towards the finger must not outlast its host, which alone bounds it.
        self.arm_watchdog()
        self.send_heartbeat()
        self.command(Controlword.START_HOMING, 0)
        self._await_home(method, guard)
        self.end_search()
        ends = (axis.lowest_m, axis.furthest_m)
        self._implausible_m = IMPLAUSIBLE * (ends[1] - ends[0])
        for subindex, end in enumerate(sorted(map(axis.units.position, ends)), 1):
            self.write_optional(0x607D, subindex, end)

    def _await_home(self, method: int, guard: Callable[[], None]) -> None:
        axis = self._axis
        deadline_s = time.monotonic() + axis.search_s
        began_ns, began_m, beat_ns = time.perf_counter_ns(), self.position_m, 0
        while self.received_ns < began_ns or self.statusword & HOMING_ATTAINED != HOMING_ATTAINED:
            guard()
            bound_search(axis, began_m, self.position_m)
            if self.state is not State.ENABLED:
                raise DriveError(
                    FaultKind.NOT_HOMED, f"{self.state.text} on its way home, {self.error}"
                )
            if self.statusword & HOMING_ERROR:
                raise DriveError(FaultKind.NOT_HOMED, f"homing method {method} fails")
            if time.monotonic() > deadline_s:
                raise DriveError(FaultKind.NOT_HOMED, f"no home within {axis.search_s:.0f} s")
            now_ns = time.perf_counter_ns()
            if now_ns - beat_ns >= self._scene.watchdog_ns // BEATS:
                beat_ns = now_ns
                self.send_heartbeat()
            time.sleep(POLL_S)

    def end_search(self) -> None:
        """See `DriveDevice.end_search`."""
        self.command(Controlword.ENABLE, 0)
        # Objects are read for longer than the watchdog permits.
        self._disarm_watchdog()
        self._select(self.mode)

    def arm_watchdog(self) -> None:
        """See `DriveDevice.arm_watchdog`: a watchdog on our heartbeats."""
        watchdog_ms = round(self._scene.watchdog_ns / 1e6)
        try:
            self._disarm_watchdog()
            self.write(0x1016, 1, self._scene.host << 16 | watchdog_ms)
        except DriveError as error:
            if error.kind is FaultKind.REFUSED:
                raise DriveError(FaultKind.NO_WATCHDOG, str(error)) from None
            raise
        self.write_optional(0x6007, 0, QUICK_STOP_ON_ABORT)

    def _disarm_watchdog(self) -> None:
        self.write(0x1016, 1, 0)

    def command(self, control: Controlword, velocity: int) -> int:
        """Send a controlword and a target velocity; return the time of sending in ns."""
        COMMAND.pack_into(self._command.data, 0, control, velocity)
        self._send(self._command)
        sent_ns = time.perf_counter_ns()
        if self.mode is Mode.CYCLIC_VELOCITY:
            self._send(self._sync)
        return sent_ns

    def send_heartbeat(self) -> None:
        """Send one heartbeat."""
        self._send(self._heartbeat)

    def close(self) -> None:
        """See `DriveDevice.close`. A drive that cannot be reached is stopped by its watchdog."""
        rest = partial(setattr, self._node.nmt, "state", "PRE-OPERATIONAL")
        # Errors of a bus that is already gone are counted.
        for leave in (self._disable, rest, self._leave):
            try:
                leave()
            except DriveError as error:
                self.counts[f"not disabled: {error.kind}"] += 1
            except Exception:
                self.counts["not closed"] += 1

    def _disable(self) -> None:
        self.command(Controlword.SHUTDOWN, 0)
        self.command(Controlword.DISABLE_VOLTAGE, 0)
        self.write(0x1016, 1, 0)

    def _leave(self) -> None:
        """Close the bus, and end the thread that reads it."""
        try:
            self._network.disconnect()
        finally:
            # The library keeps both where one of its own steps fails.
            if self._network.bus is not None:
                with ExitStack() as stack:
                    stack.callback(self._bus.shutdown)
                    if self._network.notifier is not None:
                        stack.callback(self._network.notifier.stop)

    def read(self, index: int, subindex: int = 0) -> int:
        """Read an object of the drive, by SDO."""
        with self._answering(f"0x{index:04X}:{subindex}"):
            return int(self._variable(index, subindex).raw)

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write an object of the drive, by SDO."""
        with self._answering(f"0x{index:04X}:{subindex}"):
            self._variable(index, subindex).raw = value

    def write_optional(self, index: int, subindex: int, value: int) -> None:
        """Write an object that some drives lack, or refuse to have written."""
        try:
            self.write(index, subindex, value)
        except DriveError as error:
            if error.kind is not FaultKind.REFUSED:
                raise

    def _variable(self, index: int, subindex: int) -> Any:
        entry: Any = self._node.sdo[index]
        return entry[subindex] if subindex else entry

    @contextmanager
    def _answering(self, what: str) -> Iterator[None]:
        """Turn the errors of SDOs into DriveError within a `with`."""
        from canopen import SdoAbortedError, SdoCommunicationError

        try:
            yield
        except SdoAbortedError as error:
            raise DriveError(FaultKind.REFUSED, f"{self._name} refuses {what}: {error}") from None
        except SdoCommunicationError:
            raise DriveError(
                FaultKind.NO_ANSWER, f"no answer from {self._name} about {what}"
            ) from None
        except Exception as error:
            raise DriveError(FaultKind.UNPLUGGED, f"{self._name}: {error}") from None

    @property
    def _acceleration(self) -> int:
        per_second = self._scene.velocity_scale / self._axis.units.step_m
        return min(round(self._axis.max_acceleration_m_per_s2 * per_second), 0xFFFF_FFFF)

    def _select(self, mode: Mode) -> None:
        """Set a mode of operation, and check that the drive accepts it."""
        self.write(0x6060, 0, mode)
        deadline_s = time.monotonic() + SDO_TIMEOUT_S
        while self.read(0x6061) != mode:
            if time.monotonic() > deadline_s:
                raise DriveError(FaultKind.NO_SPEED_MODE, f"{self._name} does not take mode {mode}")
            time.sleep(POLL_S)

    def _send(self, message: Any) -> None:
        # python-can interfaces raise errors of many kinds.
        if self._lost is not None:
            raise DriveError(FaultKind.UNPLUGGED, f"{self._name}: {self._lost}")
        try:
            with self._sending.acquire_or_proceed():
                self._bus.send(message, self._scene.watchdog_ns * 1e-9)
        except Exception as error:
            raise DriveError(FaultKind.UNPLUGGED, f"{self._name}: {error}") from None

    def _map(self, pdo: Any, indices: tuple[int, ...], transmission: int) -> None:
        pdo.cob_id, pdo.enabled = pdo.predefined_cob_id, True
        pdo.trans_type = transmission
        pdo.event_timer = EVENT_MS if pdo.pdo_node is self._node.tpdo else None
        pdo.clear()
        for index in indices:
            pdo.add_variable(index)
        with self._answering("the PDOs"):
            pdo.save()

    def _take(self, take: Listener, can_id: int, data: bytearray, timestamp: float) -> None:
        """Pass a message on. An exception is a fault: the library would log it and go on."""
        try:
            take(can_id, data, timestamp)
        except Exception as error:
            self._take_error(error)

    def _take_error(self, error: Exception) -> None:
        self.counts[f"error: {type(error).__name__}"] += 1
        now_ns = time.perf_counter_ns()
        self._internal = self._internal or internal_fault(Part.DRIVE, "CAN bus", error, now_ns)

    def _on_state(self, _: int, data: bytearray, __: float) -> None:
        if len(data) != STATE_TPDO.size:
            self.counts["malformed"] += 1
            return
        statusword, position = STATE_TPDO.unpack(data)
        state, position_m = state_of(statusword), self._axis.units.position_m(position)
        if state is None or abs(position_m) > self._implausible_m:
            self.counts["implausible"] += 1
            self._implausible_ns = time.perf_counter_ns()
            return
        self.statusword, self.state, self.position_m = statusword, state, position_m
        self.received_ns = time.perf_counter_ns()

    def _on_speed(self, _: int, data: bytearray, __: float) -> None:
        if len(data) != SPEED_TPDO.size:
            self.counts["malformed"] += 1
            return
        velocity, error_code = SPEED_TPDO.unpack(data)
        speed_m_per_s = self._axis.units.speed_m_per_s(velocity)
        if abs(speed_m_per_s) > IMPLAUSIBLE * self._axis.max_speed_m_per_s:
            self.counts["implausible"] += 1
            return
        self.speed_m_per_s, self.error_code = speed_m_per_s, error_code

    def _on_emergency(self, _: int, data: bytearray, __: float) -> None:
        if len(data) < 2:
            self.counts["malformed"] += 1
        elif code := int.from_bytes(data[:2], "little"):
            self.error_code = code

    def _on_heartbeat(self, _: int, data: bytearray, __: float) -> None:
        if len(data) != 1:
            self.counts["malformed"] += 1
            return
        state = data[0] & 0x7F
        if state not in NMT_STATES:
            self.counts["implausible"] += 1
            return
        # A single one that an adapter has altered must not end the pulse.
        if state in (OPERATIONAL, self._beat_state):
            self._nmt_state = state
        self._beat_state = state

    def _on_nmt_command(self, _: int, data: bytearray, __: float) -> None:
        """Note the command of another master."""
        if len(data) == 2 and data[1] in (0, self._scene.node):
            self._nmt_state = NMT_COMMANDS.get(data[0], self._nmt_state)

    def _on_bus_error(self, exc: Exception) -> None:
        """Count a frame that cannot be decoded; store the error of a bus that is gone.

        Any other exception of the bus's thread is an error in a program.
        """
        import can

        if not isinstance(exc, OSError | can.CanError) and not is_noise(exc):
            self._network.notifier.exception = None  # type: ignore[union-attr]
            self._take_error(exc)
        elif is_noise(exc):
            discard_spoilt_line(self._bus)
            self._network.notifier.exception = None  # type: ignore[union-attr]
            self.counts["garbled"] += 1
        else:
            self._lost = exc
            time.sleep(LOST_PAUSE_S)
