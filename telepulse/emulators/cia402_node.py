"""An emulated CiA 402 drive on any CAN bus, as a `canopen` LocalNode around `EmulatedDrive`."""

import struct
import time
from importlib.resources import files
from threading import RLock
from typing import Any

import can
import canopen

from display_node.drives.cia402.node import HEARTBEAT, RPDO1, SYNC
from display_node.drives.cia402.states import Mode
from display_node.drives.scene import Cia402Scene
from telepulse.emulators.cia402_drive import EmulatedDrive
from telepulse.emulators.lies import LieInjector
from telepulse.emulators.motor import EmulatedMotor

ALL_MODES = (Mode.PROFILE_VELOCITY, Mode.CYCLIC_VELOCITY)
TPDO_S = 0.01
NOTIFIER_CYCLE_S = 0.1
LAST_SYNC_TYPE = 240
DIGITAL_INPUTS = 0x60FD
_IDENTIFIER = struct.Struct(">H")


class _LyingNetwork(canopen.Network):
    """A network whose frames pass the lies of a motor on their way to the bus."""

    def __init__(self, bus: can.BusABC, lies: LieInjector) -> None:
        super().__init__(bus)
        self._lies = lies

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame when the lies let it pass."""
        self._lies.answer(
            _IDENTIFIER.pack(can_id) + bytes(data), time.monotonic_ns(), header=_IDENTIFIER.size
        )
        self.send_due()

    def send_due(self) -> None:
        """Send what was delayed until now."""
        for frame in self._lies.due(time.monotonic_ns()):
            (can_id,) = _IDENTIFIER.unpack_from(frame)
            super().send_message(can_id, frame[_IDENTIFIER.size :])


class EmulatedNode:
    """Answers SDOs, takes RPDOs, and sends TPDOs when `poll` is called.

    silent: it hears everything and says nothing, as one whose transmitter is gone.
    """

    def __init__(
        self,
        scene: Cia402Scene,
        motor: EmulatedMotor,
        bus: can.BusABC,
        modes: tuple[Mode, ...] = ALL_MODES,
    ) -> None:
        self.motor = motor
        self.drive = EmulatedDrive(scene, motor, modes)
        self.silent = False
        self._supported = sum(mode.supported_bit for mode in (*modes, Mode.HOMING))
        self._lock = RLock()
        self._waiting: tuple[int, int] | None = None
        # Its PDOs are as the host wrote them: the node's own state is there a little before.
        self._operational = False
        self._watched_id = 0
        self._said = (0, 0)
        self._sent_s = 0.0
        self._network = _LyingNetwork(bus, motor.lies)
        self._network.NOTIFIER_CYCLE = NOTIFIER_CYCLE_S
        sheet = str(files("display_node.drives.cia402") / "cia402.eds")
        self._node = canopen.LocalNode(scene.node, sheet)
        self._node.add_read_callback(self._on_read)  # type: ignore[no-untyped-call]
        self._node.add_write_callback(self._on_write)  # type: ignore[no-untyped-call]
        self._network[scene.node] = self._node
        self._network.subscribe(0, self._on_nmt)
        self._network.subscribe(SYNC, self._on_sync)
        self._network.subscribe(RPDO1 + scene.node, self._on_rpdo)
        self._network.connect()
        self._node.nmt.state = "INITIALISING"
        self._node.nmt.state = "PRE-OPERATIONAL"

    def poll(self) -> None:
        """Come to the present, and send what is due. Call it every few milliseconds."""
        with self._lock:
            self._advance()
            drive, now_s = self.drive, time.monotonic()
            said = (drive.statusword, drive.error_code)
            due = now_s - self._sent_s >= TPDO_S or said != self._said
            if due and self._operational and not self.silent:
                self._sent_s = now_s
                self._send_tpdos(said)
            self._network.send_due()

    def close(self) -> None:
        """Leave the bus."""
        self._network.disconnect()

    def _advance(self) -> None:
        self.drive.advance(time.monotonic_ns())

    def _send_tpdos(self, said: tuple[int, int]) -> None:
        if said[1] and said[1] != self._said[1]:
            self._node.emcy.send(said[1])
        self._said = said
        for number in (1, 2):
            pdo = self._node.tpdo[number]
            for variable in pdo:
                variable.raw = self._value(variable.index)
            pdo.transmit()

    def _value(self, index: int) -> int | None:
        """Return the value of an object of the drive that changes by itself."""
        drive = self.drive
        values = {
            0x603F: drive.error_code,
            0x6041: drive.statusword,
            0x6061: drive.mode,
            0x6064: drive.position,
            0x606C: drive.velocity,
            DIGITAL_INPUTS: drive.digital_inputs,
            0x6502: self._supported,
        }
        return values.get(index)

    def _on_read(self, index: int, subindex: int, od: Any) -> int | None:
        if self.silent:
            raise canopen.SdoAbortedError(0x0504_0000)
        with self._lock:
            self._advance()
            return self._value(index)

    def _on_write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        value: int = od.decode_raw(data)
        with self._lock:
            self._advance()
            match index, subindex:
                case 0x6060, _:
                    self.drive.select(value)
                case 0x6007, _:
                    self.drive.abort_option = value
                case 0x1016, 1:
                    self._watch(value)

    def _watch(self, entry: int) -> None:
        """Monitor a heartbeat, from the first one that comes."""
        self._network.subscribe(HEARTBEAT + (entry >> 16 & 0x7F), self._on_heartbeat)
        self._watched_id = HEARTBEAT + (entry >> 16 & 0x7F)
        self._watch_ns = (entry & 0xFFFF) * 1_000_000
        self.motor.watch(0)

    def _on_heartbeat(self, can_id: int, _: bytearray, __: float) -> None:
        with self._lock:
            self._advance()
            if can_id == self._watched_id and self._watch_ns:
                self.motor.watch(self._watch_ns)

    def _on_nmt(self, _: int, __: bytearray, ___: float) -> None:
        """The PDOs are as they were written when the node becomes operational."""
        with self._lock:
            self._operational = self._node.nmt.state == "OPERATIONAL"
            if not self._operational:
                return
            for pdo in (self._node.rpdo[1], self._node.tpdo[1], self._node.tpdo[2]):
                pdo.read()
                # A bus may bring us what we send ourselves.
                self._network.unsubscribe(pdo.cob_id, pdo.on_message)

    def _on_rpdo(self, _: int, data: bytearray, __: float) -> None:
        pdo = self._node.rpdo[1]
        if not self._operational or len(data) != len(pdo.data):
            return
        pdo.data = data
        told = (int(pdo[0x6040].raw), int(pdo[0x60FF].raw))
        with self._lock:
            self._waiting = told
        if pdo.trans_type > LAST_SYNC_TYPE:
            self._on_sync(SYNC, bytearray(), 0.0)

    def _on_sync(self, _: int, __: bytearray, ___: float) -> None:
        with self._lock:
            self._advance()
            if self._waiting is not None:
                self._take_settings()
                self.drive.control(*self._waiting)
                self._waiting = None

    def _take_settings(self) -> None:
        stored = self._stored
        self.drive.search_by(stored(0x6098), stored(0x6099, 1), stored(0x6099, 2))
        self.drive.limit(stored(0x607D, 1), stored(0x607D, 2))

    def _stored(self, index: int, subindex: int = 0) -> int:
        """Return what was written to an object; 0 where nothing was."""
        written = self._node.data_store.get(index, {}).get(subindex, b"")
        return int.from_bytes(written, "little", signed=True)
