"""The file under a recording: whole pieces go to the disk, or stay here until it takes them."""

import os
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from protocol.errors import OutputError

_BINARY = getattr(os, "O_BINARY", 0)


class _Piece(NamedTuple):
    data: bytes
    messages: int


class Journal:
    """Takes a recording's bytes and keeps what the disk refuses, in order, to try it again.

    A piece that fits in part is taken off the disk again: what stands there is always a row of
    whole pieces. waiting_bytes, waiting: bytes and messages that are not on the disk.
    """

    def __init__(self, path: Path) -> None:
        """Raises OutputError: where it cannot be made, and where a file is there already."""
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, 0o666)
        except FileExistsError:
            raise OutputError(f"{path}: is there already; name another file") from None
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None
        self._path = path
        self._unsealed = bytearray()
        self._pieces: deque[_Piece] = deque()
        self._given_bytes = self._on_disk_bytes = 0
        self.waiting_bytes = self.waiting = 0

    def write(self, data: bytes) -> int:
        """Take bytes; they are a part of the next piece."""
        self._unsealed += data
        self._given_bytes += len(data)
        return len(data)

    def tell(self) -> int:
        """Where in the file the next byte will be."""
        return self._given_bytes

    def flush(self) -> None:
        """Nothing: `commit` says when."""

    def commit(self, messages: int) -> str | None:
        """Make a piece of what was taken, with so many messages, and put on the disk what fits.

        Returns why something waits, None when nothing does.
        """
        if self._unsealed:
            self._pieces.append(_Piece(bytes(self._unsealed), messages))
            self.waiting_bytes += len(self._unsealed)
            self.waiting += messages
            self._unsealed.clear()
        while self._pieces:
            piece = self._pieces[0]
            try:
                self._append(piece.data)
            except OSError as error:
                return error.strerror or str(error)
            self._pieces.popleft()
            self.waiting_bytes -= len(piece.data)
            self.waiting -= piece.messages
        return None

    def close(self) -> None:
        """Close the file; what waits is given up."""
        os.close(self._file)

    def _append(self, data: bytes) -> None:
        """All of a piece, or none of it. Raises OSError."""
        left = memoryview(data)
        try:
            os.lseek(self._file, self._on_disk_bytes, os.SEEK_SET)
            while left:
                left = left[os.write(self._file, left) :]
            # Into the disk itself: it outlives a loss of power, and what fails late fails here.
            os.fsync(self._file)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file, self._on_disk_bytes)
            raise
        self._on_disk_bytes += len(data)
