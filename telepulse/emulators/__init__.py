"""Emulated hardware, byte for byte: sensor boards and drives.

Their serial ports are pseudo-terminals.
"""

import os
import tty
from pathlib import Path

from protocol.errors import OutputError


class PtyPort:
    """One end of a pseudo-terminal in place of a serial port.

    `path` is the path of the other end, which another program opens, or a link to it. Unread bytes
    are dropped once the kernel's buffer is full, as on a board with USB. A link of an earlier run
    is replaced. Raises OutputError where the link cannot be made.
    """

    def __init__(self, link: Path | None) -> None:
        self._ours, self._theirs = os.openpty()
        # Kept open: otherwise the terminal would end when its first reader closes it.
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self._link = link
        device = Path(os.ttyname(self._theirs))
        self.path = link or device
        self.dropped = 0
        if link is None:
            return
        try:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(device)
        except OSError as error:
            raise OutputError(f"{link}: cannot be made: {error.strerror}") from None

    def write(self, data: bytes) -> None:
        """Send bytes; those that do not fit are dropped and counted."""
        try:
            written = os.write(self._ours, data)
        except BlockingIOError:
            written = 0
        self.dropped += len(data) - written

    def read(self) -> bytes:
        """Return the bytes that the other program has written, if any."""
        try:
            return os.read(self._ours, 4096)
        except BlockingIOError:
            return b""

    def fileno(self) -> int:
        """Return the descriptor for `select`."""
        return self._ours

    def close(self) -> None:
        """Unplug: the other program's reads fail from now on."""
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
        os.close(self._ours)
        os.close(self._theirs)
