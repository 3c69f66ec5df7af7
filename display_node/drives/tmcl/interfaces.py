"""Carriers of TMCL datagrams: a serial port by URL, or any CAN bus.

PyTrinamic's own interfaces open serial devices by name, and the CAN channels can0 to can7 alone.
They also format every request and reply for a log, whether one is kept or not: that is most of the
cost of an exchange (decision 19), so it is left out here.
"""

import math
import time

import can
import serial
from pytrinamic.connections.tmcl_interface import TmclInterface
from pytrinamic.tmcl import TMCLReply, TMCLReplyChecksumError, TMCLReplyStatusError, TMCLRequest

from display_node.drives.can_bus import discard_spoilt_line

DATAGRAM_BYTES = 9
# More than waits on any line after two failed requests.
DRAIN_BYTES = 4096
DRAIN_FRAMES = 64
ELEVEN_BITS = 0x7FF
# Replies to other requests that are ignored before the right one.
MOST_STRAY = 2


class _QuietInterface(TmclInterface):  # type: ignore[misc]
    """PyTrinamic's interface without its log.

    Attributes
    ----------
    stray
        Number of replies to another request.
    stray_reply
        The last of them, since the present request.
    """

    stray = 0
    stray_reply: TMCLReply | None = None

    def send_request(self, request: TMCLRequest, *, no_reply: bool = False) -> TMCLReply:
        """Return the checked reply to a request; `no_reply` is not supported here.

        What waits already, and a reply to another request, is counted and ignored: the request
        before may have been answered twice. Raises TimeoutError, with `stray_reply` set where only
        such replies came.
        """
        wanted = (self._host_id, request.moduleAddress, request.command)
        self.stray_reply = None
        self.stray += self._discard()
        self._send(self._host_id, request.moduleAddress, request.to_buffer())
        for _ in range(MOST_STRAY + 1):
            reply = TMCLReply.from_buffer(self._recv(self._host_id, request.moduleAddress))
            self._reply_check(reply)
            if (reply.reply_address, reply.module_address, reply.command) == wanted:
                if not reply.is_valid():
                    raise TMCLReplyStatusError(reply)
                return reply
            self.stray += 1
            self.stray_reply = reply
        raise TimeoutError


class SerialLine(_QuietInterface):
    """Datagrams of 9 bytes on a serial line, the last of them a checksum."""

    def __init__(self, port: serial.SerialBase, host: int, module: int) -> None:
        super().__init__(host, module)
        self._port = port

    def drain(self) -> None:
        """Discard what still comes, for as long as a reply may take."""
        self._port.read(DRAIN_BYTES)
        self._port.reset_input_buffer()

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _discard(self) -> int:
        """Discard unrequested datagrams; return their number."""
        waiting: int = self._port.in_waiting
        if waiting:
            self._port.reset_input_buffer()
        return math.ceil(waiting / DATAGRAM_BYTES)

    def _send(self, host_id: int, module_id: int, data: bytes) -> None:
        try:
            self._port.write(data)
        except serial.SerialTimeoutException:
            raise TimeoutError from None

    def _recv(self, host_id: int, module_id: int) -> bytes:
        data: bytes = self._port.read(DATAGRAM_BYTES)
        if len(data) < DATAGRAM_BYTES:
            raise TimeoutError
        return data

    def _reply_check(self, reply: object) -> None:
        if not reply.is_checksum_correct():  # type: ignore[attr-defined]
            raise TMCLReplyChecksumError(reply)


class CanLine(_QuietInterface):
    """Frames of 7 bytes: the identifier is the address, and CAN has a checksum of its own."""

    def __init__(self, bus: can.BusABC, host: int, module: int, timeout_s: float) -> None:
        super().__init__(host, module)
        bus.set_filters([{"can_id": host, "can_mask": ELEVEN_BITS, "extended": False}])
        self._bus = bus
        self._timeout_s = timeout_s

    def drain(self) -> None:
        """Discard what still comes, for as long as a reply may take."""
        discard_spoilt_line(self._bus)
        for _ in range(DRAIN_FRAMES):
            if self._bus.recv(self._timeout_s) is None:
                break

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()

    def _discard(self) -> int:
        """Discard unrequested datagrams; return their number."""
        for discarded in range(DRAIN_FRAMES):
            if self._bus.recv(0.0) is None:
                return discarded
        return DRAIN_FRAMES

    def _send(self, host_id: int, module_id: int, data: bytes) -> None:
        frame = can.Message(arbitration_id=module_id, is_extended_id=False, data=data[1:8])
        try:
            self._bus.send(frame, timeout=self._timeout_s)
        except can.CanError as error:
            # The error of an slcan interface whose port has taken too long.
            if isinstance(error.__cause__, serial.SerialTimeoutException):
                raise TimeoutError from None
            raise

    def _recv(self, host_id: int, module_id: int) -> bytes:
        deadline_s = time.monotonic() + self._timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            frame = self._bus.recv(left_s)
            if frame is not None and len(frame.data) == DATAGRAM_BYTES - 2:
                return bytes([frame.arbitration_id, *frame.data])
        raise TimeoutError
