"""Lines to an emulated TMCL module: a pseudo-terminal, or a CAN bus."""

import select
import time

import can

from display_node.drives.scene import TmclScene
from telepulse.emulate.pty_port import PtyPort
from telepulse.emulate.tmcl_module import Datagrams, EmulatedModule, checksum


class SerialLine:
    """Datagrams of 9 bytes on a pseudo-terminal."""

    def __init__(self, module: EmulatedModule, port: PtyPort) -> None:
        self._module = module
        self._port = port
        self._datagrams = Datagrams()

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


class CanLine:
    """Frames of 7 bytes to the module's identifier, answered from the host's."""

    def __init__(self, module: EmulatedModule, scene: TmclScene, bus: can.BusABC) -> None:
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


def _answer(module: EmulatedModule, request: bytes) -> None:
    """Leave the reply to a request in the module's lies, which send it."""
    reply = module.reply(request, time.monotonic_ns())
    if module.answers == "late":
        time.sleep(module.late_s)
    if reply:
        module.lies.answer(reply, time.monotonic_ns())
