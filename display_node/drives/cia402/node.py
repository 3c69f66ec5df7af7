"""A CiA 402 drive on its bus: configured by SDO, commanded by RPDO, reporting by TPDO."""

import logging
import math
import struct
import time
from collections import Counter
from importlib.resources import files
from typing import TYPE_CHECKING

from display_node.drives.axis import Axis
from display_node.drives.can_bus import BusErrors, open_bus
from display_node.drives.cia402.state_machine import Control, Mode, State, state_of
from display_node.drives.scene import Cia402Scene
from display_node.drives.supervisor import PassableLock
from protocol.errors import DriveError

if TYPE_CHECKING:
    import can
    from canopen.pdo import PdoMap

PROFILE = 402
SYNC = 0x80
EMERGENCY, TPDO1, TPDO2, RPDO1, HEARTBEAT = 0x80, 0x180, 0x280, 0x200, 0x700
OPERATIONAL = b"\x05"
BY_SYNC, BY_EVENT = 1, 255
# Greatest time between two TPDOs, so that silence differs from rest.
EVENT_MS = 10
SDO_TIMEOUT_S = 0.5
NOTIFIER_CYCLE_S = 0.1
POLL_S = 0.002
QUICK_STOP_ON_ABORT = 3
COMMAND = struct.Struct("<Hi")
STATE_TPDO = struct.Struct("<Hi")
SPEED_TPDO = struct.Struct("<iH")
# No axis is so many times faster than its fastest, nor, once homed, so many times its travel away.
IMPLAUSIBLE = 10

# Errors are raised or counted here; a program that wants canopen's log can still have it.
QUIET = logging.NullHandler()

ERRORS = {
    0x4210: "overtemperature",
    0x4310: "overtemperature",
    0x7121: "motor blocked",
    0x8130: "it missed our heartbeat",
    0x8611: "following error",
}


class Cia402Node:
    """One drive and its last reports. Methods raise DriveError.

    Attributes
    ----------
    statusword, state, error_code, position_m, speed_m_per_s
        By its TPDOs.
    received_ns
        Time of the last TPDO on the monotonic clock.
    counts
        "malformed" TPDOs and emergencies, "implausible" TPDOs, whose values are not used, frames
        that a CAN adapter sends "garbled", and a bus that was "not closed".
    """

    def __init__(self, scene: Cia402Scene, axis: Axis, counts: Counter[str]) -> None:
        """Open the bus."""
        try:
            import can
            import canopen
        except ImportError as error:
            raise DriveError(
                "unplugged", f"canopen is missing ({error}); pip install 'telepulse[drives]'"
            ) from None
        logging.getLogger("canopen").addHandler(QUIET)
        self._name = f"node {scene.node} on {scene.interface} {scene.channel}"
        self._scene = scene
        self._axis = axis
        self.counts = counts
        self.statusword = self.error_code = 0
        self.state = State.NOT_READY
        self.position_m = axis.lowest_m
        self.speed_m_per_s = 0.0
        self.received_ns = self._implausible_ns = 0
        # Before homing the drive's count has any origin.
        self._implausible_m = math.inf
        self.cyclic = True
        # Made once: making a message costs a third of sending it.
        self._command = can.Message(
            arbitration_id=RPDO1 + scene.node, is_extended_id=False, data=bytes(COMMAND.size)
        )
        self._sync = can.Message(arbitration_id=SYNC, is_extended_id=False)
        self._heartbeat = can.Message(
            arbitration_id=HEARTBEAT + scene.host, is_extended_id=False, data=OPERATIONAL
        )
        self._bus = open_bus(scene)
        self._network = canopen.Network(self._bus)
        self._network.NOTIFIER_CYCLE = NOTIFIER_CYCLE_S
        # canopen's own threads send as well.
        self._sending = PassableLock(self._network.send_lock)
        sheet = str(files("display_node.drives.cia402") / "cia402.eds")
        self._node = canopen.RemoteNode(scene.node, sheet)
        self._node.sdo.RESPONSE_TIMEOUT = SDO_TIMEOUT_S
        self._network.add_node(self._node)
        self._network.subscribe(TPDO1 + scene.node, self._on_state)
        self._network.subscribe(TPDO2 + scene.node, self._on_speed)
        # The library's own listener keeps all emergencies, and fails at one that is cut short.
        self._network.unsubscribe(EMERGENCY + scene.node, self._node.emcy.on_emcy)
        self._network.subscribe(EMERGENCY + scene.node, self._on_emergency)
        self._errors = BusErrors(self._network, counts)
        # Anything that python-can's notifier can call will do.
        self._network.listeners.append(self._errors)  # type: ignore[arg-type]
        self._network.connect()

    @property
    def error(self) -> str:
        """The name of its last error code."""
        code = self.error_code
        return ERRORS.get(code, f"error 0x{code:04X}") if code else "no error code"

    @property
    def silence(self) -> str:
        """The name of a fault where nothing plausible has come for a while."""
        if self._implausible_ns > self.received_ns:
            return "garbled: no plausible TPDO"
        return "no answer"

    def configure(self) -> None:
        """Check the profile, set PDOs, limits and mode, and start the PDOs."""
        scene, axis = self._scene, self._axis
        self._node.nmt.state = "PRE-OPERATIONAL"
        profile = self.read(0x1000) & 0xFFFF
        if profile != PROFILE:
            raise DriveError("refused", f"{self._name} has profile {profile}, not {PROFILE}")
        self.cyclic = self._chosen_mode() is Mode.CYCLIC_VELOCITY
        receive, state, speed = self._node.rpdo[1], self._node.tpdo[1], self._node.tpdo[2]
        self._map(receive, (0x6040, 0x60FF), BY_SYNC if self.cyclic else BY_EVENT)
        self._map(state, (0x6041, 0x6064), BY_EVENT)
        self._map(speed, (0x606C, 0x603F), BY_EVENT)
        per_second = scene.velocity_scale / axis.units.step_m
        acceleration = min(round(axis.max_acceleration_m_per_s2 * per_second), 0xFFFF_FFFF)
        for index in (0x6083, 0x6084, 0x6085):
            self.write_optional(index, 0, acceleration)
        self.write_optional(0x60C2, 1, min(round(scene.period_ns / 1e5), 255))
        self.write_optional(0x60C2, 2, -4)
        self._node.nmt.state = "OPERATIONAL"

    def limit_travel(self) -> None:
        """Set the drive's own soft limits, and ignore positions far beyond them. After homing."""
        ends = (self._axis.lowest_m, self._axis.furthest_m)
        self._implausible_m = IMPLAUSIBLE * (ends[1] - ends[0])
        for subindex, end in enumerate(sorted(map(self._axis.units.position, ends)), 1):
            self.write_optional(0x607D, subindex, end)

    def arm_watchdog(self) -> None:
        """Have the drive stop by itself when heartbeats stop, from the next one on."""
        watchdog_ms = round(self._scene.watchdog_ns / 1e6)
        self.write(0x1016, 1, 0)
        self.write(0x1016, 1, self._scene.host << 16 | watchdog_ms)
        self.write_optional(0x6007, 0, QUICK_STOP_ON_ABORT)

    def disarm_watchdog(self) -> None:
        """Have the drive expect no heartbeats."""
        self.write(0x1016, 1, 0)

    def select(self, mode: Mode) -> None:
        """Set a mode of operation, and check that the drive takes it."""
        self.write(0x6060, 0, mode)
        deadline_s = time.monotonic() + SDO_TIMEOUT_S
        while self.read(0x6061) != mode:
            if time.monotonic() > deadline_s:
                raise DriveError("refused", f"{self._name} does not take mode {mode}")
            time.sleep(POLL_S)

    def select_velocity(self) -> None:
        """Set the mode in which the drive takes speeds."""
        self.select(Mode.CYCLIC_VELOCITY if self.cyclic else Mode.PROFILE_VELOCITY)

    def command(self, control: Control, velocity: int) -> int:
        """Send a controlword and a target velocity; return the time of sending in ns."""
        COMMAND.pack_into(self._command.data, 0, control, velocity)
        self._send(self._command)
        sent_ns = time.monotonic_ns()
        if self.cyclic:
            self._send(self._sync)
        return sent_ns

    def _send(self, message: "can.Message") -> None:
        # Each python-can interface has errors of its own.
        try:
            if self._errors.lost is not None:
                raise self._errors.lost
            with self._sending.passing():
                self._bus.send(message, self._scene.watchdog_ns * 1e-9)
        except Exception as error:
            raise DriveError("unplugged", f"{self._name}: {error}") from None

    def send_heartbeat(self) -> None:
        """Send one heartbeat."""
        self._send(self._heartbeat)

    def close(self) -> None:
        """Close the bus. Never raises: a bus that is gone already is counted."""
        for leave in (self._rest, self._network.disconnect):
            try:
                leave()
            except Exception:
                self.counts["not closed"] += 1

    def read(self, index: int, subindex: int = 0) -> int:
        """Read an object of the drive, by SDO."""
        return int(self._sdo(index, subindex, None))

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write an object of the drive, by SDO."""
        self._sdo(index, subindex, value)

    def write_optional(self, index: int, subindex: int, value: int) -> None:
        """Write an object that not every drive has, or allows to be written."""
        try:
            self.write(index, subindex, value)
        except DriveError as error:
            if error.kind != "refused":
                raise

    def _sdo(self, index: int, subindex: int, value: int | None) -> int:
        from canopen import SdoAbortedError, SdoCommunicationError

        entry = self._node.sdo[index]
        try:
            variable = entry[subindex] if subindex else entry
            if value is None:
                return int(variable.raw)
            variable.raw = value
            return value
        except SdoAbortedError as error:
            text = f"{self._name} refuses 0x{index:04X}:{subindex}: {error}"
            raise DriveError("refused", text) from None
        except SdoCommunicationError:
            text = f"no answer from {self._name} about 0x{index:04X}:{subindex}"
            raise DriveError("no answer", text) from None
        except Exception as error:
            raise DriveError("unplugged", f"{self._name}: {error}") from None

    def _rest(self) -> None:
        self._node.nmt.state = "PRE-OPERATIONAL"

    def _chosen_mode(self) -> Mode:
        supported = self.read(0x6502)
        for name, mode in (("cyclic", Mode.CYCLIC_VELOCITY), ("profile", Mode.PROFILE_VELOCITY)):
            if self._scene.mode in ("auto", name) and supported & mode.supported_bit:
                return mode
        text = f"{self._name} has no velocity mode that fits mode = {self._scene.mode!r}"
        raise DriveError("refused", f"{text} (0x6502 is 0x{supported:X})")

    def _map(self, pdo: "PdoMap", indices: tuple[int, ...], transmission: int) -> None:
        from canopen import SdoAbortedError, SdoCommunicationError

        pdo.cob_id, pdo.enabled = pdo.predefined_cob_id, True
        pdo.trans_type = transmission
        pdo.event_timer = EVENT_MS if pdo.pdo_node is self._node.tpdo else None
        pdo.clear()
        for index in indices:
            pdo.add_variable(index)
        try:
            pdo.save()
        except SdoAbortedError as error:
            raise DriveError("refused", f"{self._name} refuses the PDOs: {error}") from None
        except SdoCommunicationError:
            raise DriveError("no answer", f"no answer from {self._name} about PDOs") from None

    def _on_state(self, _: int, data: bytearray, __: float) -> None:
        if len(data) != STATE_TPDO.size:
            self.counts["malformed"] += 1
            return
        statusword, position = STATE_TPDO.unpack(data)
        state, position_m = state_of(statusword), self._axis.units.position_m(position)
        if state is None or abs(position_m) > self._implausible_m:
            self.counts["implausible"] += 1
            self._implausible_ns = time.monotonic_ns()
            return
        self.statusword, self.state, self.position_m = statusword, state, position_m
        self.received_ns = time.monotonic_ns()

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
