"""Answers of a TMCL module to successive requests, on a serial line."""

from collections import Counter
from contextlib import suppress
from unittest.mock import patch

import serial

from protocol.config.scene import validate
from protocol.errors import DriveError
from pulse_drives.scene import TmclScene
from pulse_drives.tmcl.line import DATAGRAM_BYTES, TmclLine
from pulse_drives.tmcl.module import Command, Parameter
from telepulse.emulators.tmcl import DATAGRAM, checksum


class _Port:
    """A serial port that delivers given bytes after any request."""

    data = b""
    # Before the request.
    in_waiting = 0

    def read(self, count: int) -> bytes:
        taken, self.data = self.data[:count], self.data[count:]
        return taken

    def write(self, data: bytes) -> int:
        return len(data)

    def reset_input_buffer(self) -> None:
        self.data = b""


_PORT = _Port()
with patch.object(serial, "serial_for_url", lambda *_, **__: _PORT):
    _SCENE = validate({"kind": "tmcl", "port": "fuzz"}, TmclScene, where="fuzz")
    _LINE = TmclLine(_SCENE, Counter())


def seeds() -> list[bytes]:
    """Return replies that succeed, that fail, to another command, and with a wrong checksum."""
    replies = ((100, 6, 5), (100, 6, -5), (3, 6, 0), (100, 5, 0), (77, 6, 9))
    bodies = [DATAGRAM.pack(2, 1, *reply, 0)[:-1] for reply in replies]
    return [body + b"\0" for body in bodies] + [bodies[0] + b"\1"]


def try_one(data: bytes) -> None:
    """Read answers: each is a number or a DriveError.

    A checksum of 0 is replaced by the right one, which cannot be guessed.
    """
    for start in range(0, len(data), DATAGRAM_BYTES):
        reply = data[start : start + DATAGRAM_BYTES]
        if len(reply) == DATAGRAM_BYTES and not reply[-1]:
            reply = reply[:-1] + bytes([checksum(reply[:-1])])
        _PORT.data = reply
        with suppress(DriveError):
            value = _LINE.request(Command.GET_AXIS, Parameter.ACTUAL_SPEED, 0)
            assert -(1 << 31) <= value < 1 << 31
