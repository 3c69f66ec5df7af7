"""An emulated CAN adapter of the slcan kind, and the CAN bus behind it with one emulated node.

The lines are those of the LAWICEL CANUSB manual, which other adapters adopted: a letter for the
command, hexadecimal digits for identifier and data, a carriage return at the end. Not modelled:
bit rates, arbitration, bus errors, time stamps, acceptance filters.
"""

import select
from collections import deque
from typing import Any

import can

from telepulse.emulators import PtyPort

OK, REFUSED = b"\r", b"\a"
# Version, serial number and status, by the letter that requests them.
REPLIES = {"": OK, "V": b"V1013\r", "N": b"NA123\r", "F": b"F00\r"}
BIT_RATES = range(9)
# A line of the longest frame: letter, identifier, length, eight bytes.
LONGEST = 1 + 8 + 1 + 16


class SlcanAdapter:
    """The adapter: lines of the host in, answers and frames out. Pure.

    Frames pass only while the host has opened the adapter. refused: number of lines answered by a
    bell character, the error answer.
    """

    def __init__(self) -> None:
        self._line = b""
        self.is_open = False
        self.refused = 0

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
                self.refused += 1
                answer, frame = REFUSED, None
            answers += answer
            frames += [frame] if frame is not None else []
        return answers, frames

    def encode(self, frame: can.Message) -> bytes:
        """Return the host's line for a frame from the bus; nothing while closed."""
        if not self.is_open:
            return b""
        letter, digits = ("T", 8) if frame.is_extended_id else ("t", 3)
        letter = letter.replace("t", "r").replace("T", "R") if frame.is_remote_frame else letter
        data = "" if frame.is_remote_frame else frame.data.hex().upper()
        return f"{letter}{frame.arbitration_id:0{digits}X}{frame.dlc}{data}\r".encode()

    def _execute(self, line: bytes) -> tuple[bytes, can.Message | None]:
        """Execute a line. Raises ValueError for an unknown one."""
        if len(line) > LONGEST:
            raise ValueError("too long")
        text = line.decode("ascii")
        match text[:1]:
            case letter if letter in REPLIES:
                return REPLIES[letter], None
            case "S" if not self.is_open and int(text[1:]) in BIT_RATES:
                return OK, None
            case "O" | "L" | "C" if len(text) == 1:
                self.is_open = text != "C"
                return OK, None
            case "t" | "T" | "r" | "R" if self.is_open:
                return (b"z\r" if text[0] in "tr" else b"Z\r"), _frame(text)
        raise ValueError("unknown command, or not allowed now")


def _frame(text: str) -> can.Message:
    """Decode a frame. Raises ValueError."""
    extended, remote = text[0] in "TR", text[0] in "rR"
    digits = 8 if extended else 3
    length = int(text[1 + digits : 2 + digits])
    data = bytes.fromhex(text[2 + digits :])
    if len(data) != (0 if remote else length):
        raise ValueError("the number of data bytes differs from the length")
    return can.Message(
        arbitration_id=int(text[1 : 1 + digits], 16),
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=length,
        data=data,
        check=True,
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
