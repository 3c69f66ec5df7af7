"""The line of a TMCL module: datagrams on a serial port or on a CAN bus, and their errors.

PyTrinamic, by the modules' maker, encodes and decodes. Its interfaces are not used: they open only
serial devices by name and the CAN channels can0 to can7. They also format every request and reply
for a log that may not exist, which is most of the cost of an exchange (decision 19).
"""

import math
import time
from collections import Counter

import can
import serial
from pytrinamic.tmcl import TMCLReply, TMCLRequest, TMCLStatus

from protocol.errors import DriveError
from protocol.faults import FaultKind
from pulse_drives.scene import TmclScene, discard_spoilt_line, is_noise, open_bus, open_port

DATAGRAM_BYTES = 9
# More than can wait after two failed requests: bytes on a serial line, frames on CAN.
DRAIN_BYTES = 4096
DRAIN_FRAMES = 64
ELEVEN_BITS = 0x7FF
# Number of replies to other requests that are ignored before the right one.
MOST_STRAY = 2


class SerialLine:
    """Datagrams of 9 bytes on a serial line, the last of them a checksum."""

    def __init__(self, scene: TmclScene) -> None:
        assert scene.port is not None
        reply_s, watchdog_s = scene.reply_timeout_ns * 1e-9, scene.watchdog_ns * 1e-9
        self._port = open_port(scene.port, scene.baud, reply_s, watchdog_s)

    def send(self, data: bytes) -> None:
        """Send a request. Raises TimeoutError where it was not sent in time."""
        try:
            self._port.write(data)
        except serial.SerialTimeoutException:
            raise TimeoutError from None

    def receive(self) -> bytes:
        """Return the next reply; empty where none comes in time."""
        data: bytes = self._port.read(DATAGRAM_BYTES)
        return data if len(data) == DATAGRAM_BYTES else b""

    def discard(self) -> int:
        """Discard waiting replies, which no request expects; return their number."""
        waiting: int = self._port.in_waiting
        if waiting:
            self._port.reset_input_buffer()
        return math.ceil(waiting / DATAGRAM_BYTES)

    def drain(self) -> None:
        """Discard everything that arrives within a reply's time."""
        self._port.read(DRAIN_BYTES)
        self._port.reset_input_buffer()

    def close(self) -> None:
        """Close the port."""
        self._port.close()


class CanLine:
    """Frames of 7 bytes: the identifier is the address, and CAN has a checksum of its own."""

    def __init__(self, scene: TmclScene) -> None:
        self._bus = open_bus(scene)
        self._bus.set_filters([{"can_id": scene.host, "can_mask": ELEVEN_BITS, "extended": False}])
        self._timeout_s = scene.reply_timeout_ns * 1e-9

    def send(self, data: bytes) -> None:
        """See `SerialLine.send`."""
        frame = can.Message(arbitration_id=data[0], is_extended_id=False, data=data[1:8])
        try:
            self._bus.send(frame, timeout=self._timeout_s)
        except can.CanError as error:
            # The cause shows that an slcan interface's port has taken too long.
            if isinstance(error.__cause__, serial.SerialTimeoutException):
                raise TimeoutError from None
            raise

    def receive(self) -> bytes:
        """See `SerialLine.receive`."""
        deadline_s = time.monotonic() + self._timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            frame = self._bus.recv(left_s)
            if frame is not None and len(frame.data) == DATAGRAM_BYTES - 2:
                return bytes([frame.arbitration_id, *frame.data])
        return b""

    def discard(self, wait_s: float = 0.0) -> int:
        """See `SerialLine.discard`."""
        for discarded in range(DRAIN_FRAMES):
            if self._bus.recv(wait_s) is None:
                return discarded
        return DRAIN_FRAMES

    def drain(self) -> None:
        """See `SerialLine.drain`."""
        discard_spoilt_line(self._bus)
        self.discard(self._timeout_s)

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()


class TmclLine:
    """One request at a time, each waiting for its reply.

    Attributes
    ----------
    carrier
        The serial line or CAN bus.
    counts
        Missing replies ("no answer"), replies with a wrong checksum ("garbled"), and ignored
        replies of another module or to another command ("wrong").
    """

    def __init__(self, scene: TmclScene, counts: Counter[str]) -> None:
        """Open the line. Raises DriveError."""
        self._name = scene.port or f"{scene.interface} {scene.channel}"
        self._host, self._module = scene.host, scene.module
        self.carrier: SerialLine | CanLine = (
            CanLine(scene) if scene.port is None else SerialLine(scene)
        )
        self.counts = counts

    def request(self, command: int, kind: int, motor: int, value: int = 0) -> int:
        """Send a request and return the signed value of its reply.

        Raises DriveError of kind "no answer", "garbled", "wrong" (only replies to other requests
        came), "refused" or "unplugged". After the first three, what arrives within one more reply
        time is discarded. A still later reply is ignored only if it is to another command.
        """
        try:
            reply = self._exchange(TMCLRequest(self._module, command, kind, motor, value))
        except TimeoutError:
            reply = None
        except (OSError, can.CanError, ValueError, IndexError) as error:
            if is_noise(error):
                return self._miss(FaultKind.GARBLED, "an answer cannot be read")
            raise DriveError(FaultKind.UNPLUGGED, f"{self._name}: {error}") from None
        if reply is None:
            return self._miss(FaultKind.NO_ANSWER, f"no answer to command {command}")
        if not reply.is_checksum_correct():
            return self._miss(FaultKind.GARBLED, "an answer's checksum is wrong")
        if not self._answers(reply, command):
            addresses = f"{reply.module_address} to {reply.reply_address}"
            return self._miss(
                FaultKind.WRONG_DEVICE, f"an answer by {addresses}, about command {reply.command}"
            )
        if not reply.is_valid():
            status = TMCLStatus.get_name(reply.status).lower()
            text = f"{self._name}: command {command}, type {kind} is refused: {status}"
            raise DriveError(FaultKind.REFUSED, text)
        number: int = reply.value
        return number - (1 << 32) if number >= 1 << 31 else number

    def _exchange(self, request: TMCLRequest) -> TMCLReply | None:
        """Return the reply to a request, else the last reply to another request, else None.

        Waiting replies, and replies to other requests, are counted and ignored: the previous
        request may have been answered twice. A reply with a wrong checksum ends the exchange.
        """
        reply, waiting = None, self.carrier.discard()
        if waiting:
            self.counts["wrong"] += waiting
        self.carrier.send(request.to_buffer())
        for _ in range(MOST_STRAY + 1):
            data = self.carrier.receive()
            if not data:
                break
            reply = TMCLReply.from_buffer(data)
            if not reply.is_checksum_correct() or self._answers(reply, request.command):
                break
            self.counts["wrong"] += 1
        return reply

    def _answers(self, reply: TMCLReply, command: int) -> bool:
        theirs = (reply.reply_address, reply.module_address, reply.command)
        return bool(theirs == (self._host, self._module, command))

    def _miss(self, kind: FaultKind, text: str) -> int:
        """Count an error and wait until the line is silent. Raises DriveError."""
        if kind is not FaultKind.WRONG_DEVICE:  # the exchange has counted those
            self.counts[kind.value] += 1
        try:
            self.carrier.drain()
        except (OSError, can.CanError, ValueError, IndexError) as error:
            if not is_noise(error):
                raise DriveError(FaultKind.UNPLUGGED, f"{self._name}: {error}") from None
            self.counts["garbled"] += 1
        raise DriveError(kind, f"{self._name}: {text}")

    def close(self) -> None:
        """Close the line."""
        self.carrier.close()
