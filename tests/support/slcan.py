"""An emulated CAN adapter of the slcan kind, and the CAN bus behind it with one emulated node.

The lines are those of the LAWICEL CANUSB manual, which other adapters adopted: a letter for the
command, hexadecimal digits for identifier and data, a carriage return at the end. Not modelled:
extended identifiers, remote frames, bit rates, arbitration, bus errors, time stamps, filters.
"""

import select
from collections import deque
from typing import Any

import can

from telepulse.emulators import PtyPort

OK, REFUSED = b"\r", b"\a"
BIT_RATES = range(9)
# A line of the longest frame: letter, identifier, length, eight bytes.
LONGEST = 1 + 3 + 1 + 16


class SlcanAdapter:
    """The adapter: lines of the host in, answers and frames out. Pure.

    Frames pass only while the host has opened the adapter.
    """

    def __init__(self) -> None:
        self._line = b""
        self.is_open = False

    def feed(self, data: bytes) -> tuple[bytes, list[can.Message]]:
        """Return the answers to these bytes, and the frames for the bus."""
        *lines, rest = (self._line + data).split(b"\r")
        # Of an endless line, only enough is kept to recognise it as too long.
        self._line = rest[: LONGEST + 1]
        answers, frames = b"", []
        for line in lines:
            try:
                answer, frame = self._execute(line)
            except ValueError:
                answer, frame = REFUSED, None
            answers += answer
            frames += [frame] if frame is not None else []
        return answers, frames

    def encode(self, frame: can.Message) -> bytes:
        """Return the host's line for a frame from the bus; nothing while closed."""
        if not self.is_open:
            return b""
        return f"t{frame.arbitration_id:03X}{frame.dlc}{frame.data.hex().upper()}\r".encode()

    def _execute(self, line: bytes) -> tuple[bytes, can.Message | None]:
        """Execute a line. Raises ValueError for an unknown one."""
        if len(line) > LONGEST:
            raise ValueError("too long")
        text = line.decode("ascii")
        match text[:1]:
            case "":
                return OK, None
            case "S" if not self.is_open and int(text[1:]) in BIT_RATES:
                return OK, None
            case "O" | "L" | "C" if len(text) == 1:
                self.is_open = text != "C"
                return OK, None
            case "t" if self.is_open:
                return b"z\r", _frame(text)
        raise ValueError("unknown command, or not allowed now")


def _frame(text: str) -> can.Message:
    """Decode a frame. Raises ValueError."""
    data = bytes.fromhex(text[5:])
    if len(data) != int(text[4:5]):
        raise ValueError("the number of data bytes differs from the length")
    return can.Message(
        arbitration_id=int(text[1:4], 16), is_extended_id=False, data=data, check=True
    )


class SlcanBus(can.BusABC):
    """Bus of a node behind an emulated adapter, whose serial port is closed with the bus."""

    def __init__(self, port: PtyPort) -> None:
        super().__init__(channel=str(port.path))
        self.channel_info = f"slcan {port.path}"
        self._port = port
        self._adapter = SlcanAdapter()
        self._waiting: deque[can.Message] = deque()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send the host a frame; without a reader it is dropped, as by an adapter."""
        self._port.write(self._adapter.encode(msg))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._waiting and select.select([self._port], [], [], timeout)[0]:
            answers, frames = self._adapter.feed(self._port.read())
            self._port.write(answers)
            self._waiting.extend(frames)
        return (self._waiting.popleft() if self._waiting else None), False

    def fileno(self) -> int:
        """Return the descriptor for `select`."""
        return self._port.fileno()

    def shutdown(self) -> None:
        """Unplug the adapter."""
        if not self._is_shutdown:
            super().shutdown()
            self._port.close()

    def _apply_filters(self, filters: Any) -> None:
        """Do nothing: python-can filters received frames itself."""
