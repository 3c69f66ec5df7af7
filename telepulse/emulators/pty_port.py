"""A pseudo-terminal that stands for a serial port: what is written here, another program reads."""

import os
import tty
from pathlib import Path

from protocol.errors import OutputError


class PtyPort:
    """One end of a pseudo-terminal; `path` is the other's, or a link to it.

    What nobody reads is dropped once the kernel's buffer is full, as by a board on USB.
    """

    def __init__(self, link: Path | None) -> None:
        """`link` is made, in place of one that an earlier run left. Raises OutputError."""
        self._ours, self._theirs = os.openpty()
        # Kept open: a reader that comes and goes would otherwise end the terminal.
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
        """Send bytes; what does not fit is dropped, and counted."""
        try:
            written = os.write(self._ours, data)
        except BlockingIOError:
            written = 0
        self.dropped += len(data) - written

    def read(self) -> bytes:
        """What the other program has written; nothing when there is nothing."""
        try:
            return os.read(self._ours, 4096)
        except BlockingIOError:
            return b""

    def fileno(self) -> int:
        """For `select`."""
        return self._ours

    def close(self) -> None:
        """Unplug: the other program's reads fail from now on."""
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
        os.close(self._ours)
        os.close(self._theirs)
