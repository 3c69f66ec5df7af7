"""Emulated sensor boards and drives, byte for byte; their serial ports are pseudo-terminals."""

import os
import sys
from contextlib import suppress
from pathlib import Path

from protocol.errors import OutputError

# An emulated device that its machine keeps waiting for longer looks like one that fails.
LATE_MS = 15.0


class PtyPort:
    """One end of a pseudo-terminal in place of a serial port.

    path: the other end, which another program opens, or `link`, a symbolic link to it that replaces
    one of an earlier run. dropped: bytes dropped because the kernel's buffer was full, as on a
    board with USB. Raises OutputError where the link cannot be made, and on Windows.
    """

    def __init__(self, link: Path | None) -> None:
        if sys.platform == "win32":
            raise OutputError("Windows has no pseudo-terminals, which emulated serial ports need")
        import tty

        self._ours, self._theirs = os.openpty()
        # Kept open: otherwise the terminal would end when its first reader closes it.
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self._link = link
        device = Path(os.ttyname(self._theirs))
        self.path = link or device
        self.dropped = 0
        if link is not None:
            try:
                self._remove_link()
                link.symlink_to(device)
            except OSError as error:
                raise OutputError(f"{link}: cannot be made: {error.strerror}") from None

    def write(self, data: bytes) -> None:
        """Send bytes; those that do not fit are dropped and counted."""
        self.dropped += len(data)
        with suppress(BlockingIOError):
            self.dropped -= os.write(self._ours, data)

    def read(self) -> bytes:
        """Return the bytes that the other program has written, if any."""
        try:
            return os.read(self._ours, 4096)
        except BlockingIOError:
            return b""

    def fileno(self) -> int:
        """Return the descriptor to wait for."""
        return self._ours

    def close(self) -> None:
        """Unplug: the other program's reads fail from now on."""
        self._remove_link()
        os.close(self._ours)
        os.close(self._theirs)

    def _remove_link(self) -> None:
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
