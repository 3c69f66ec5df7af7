"""Keys, one at a time, from a terminal or a pipe. POSIX."""

import os
import re
import select
import sys
from collections import deque
from typing import Any

from protocol.errors import SourceError
from telepulse.experiment.dialogue import STOP_KEY

# What an arrow key and its like send has letters in it.
ESCAPED = re.compile(r"\x1b(\[[0-9;]*[A-Za-z~]|O[A-Za-z]|.)?")


AWAIT_S = 1.0


class Keyboard:
    """Standard input, without echo and without waiting for Enter, within a `with`."""

    def __init__(self) -> None:
        """Raises SourceError where there are no POSIX terminals."""
        try:
            import termios
            import tty
        except ImportError:
            raise SourceError(
                "keys are read from POSIX terminals, and this system has none"
            ) from None
        self._termios: Any = termios
        self._tty: Any = tty
        self._descriptor = sys.stdin.fileno()
        self._is_terminal = os.isatty(self._descriptor)
        self._typed: deque[str] = deque()

    def __enter__(self) -> "Keyboard":
        if self._is_terminal:
            self._before = self._termios.tcgetattr(self._descriptor)
            self._tty.setcbreak(self._descriptor, self._termios.TCSANOW)
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_terminal:
            # At once: to wait until the terminal has taken all output may be to wait for ever.
            self._termios.tcsetattr(self._descriptor, self._termios.TCSANOW, self._before)

    def key(self, wait_s: float = 0.0) -> str | None:
        """The next key in lower case, None where none comes in time; q when there are no more."""
        if not self._typed:
            self._read(wait_s)
        return self._typed.popleft() if self._typed else None

    def await_key(self) -> str:
        """Wait for the next key."""
        while True:
            key = self.key(AWAIT_S)
            if key is not None:
                return key

    def wants_to_stop(self) -> bool:
        """Return whether q is among the keys that wait. What a pipe holds is in its order, and
        waits."""
        if self._is_terminal:
            self._read(0.0)
        return self._is_terminal and STOP_KEY in self._typed

    def _read(self, wait_s: float) -> None:
        if not select.select([self._descriptor], [], [], wait_s)[0]:
            return
        # A pipe one key at a time: what comes after is read when it is asked for.
        data = os.read(self._descriptor, 64 if self._is_terminal else 1)
        if not data:
            self._typed.append(STOP_KEY)
        text = ESCAPED.sub("", data.decode(errors="ignore")).lower()
        self._typed.extend(key for key in text if not key.isspace())
