"""Single keys typed at a terminal, without waiting for Enter."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

STDIN = 0

if sys.platform == "win32":

    def key_presses() -> str:
        """Return the keys that were typed since the last call; call it often."""
        import msvcrt

        keys = ""
        while msvcrt.kbhit():
            keys += msvcrt.getwch()
        return keys

    @contextmanager
    def terminal_restored() -> Iterator[None]:
        """Do nothing: a console of Windows keeps its modes."""
        yield

else:
    import select
    import termios
    import tty

    def key_presses() -> str:
        """Return the keys that were typed since the last call; call it often.

        Switches the terminal to single keys without echo: call it within `terminal_restored`.
        A program in the background must not read, as the shell would stop it.
        """
        if not _in_foreground():
            return ""
        # Each time: a shell restores its own modes where the program was stopped and continued.
        if termios.tcgetattr(STDIN)[tty.LFLAG] & (termios.ICANON | termios.ECHO):
            tty.setcbreak(STDIN, termios.TCSANOW)
        if not select.select([STDIN], [], [], 0)[0]:
            return ""
        return os.read(STDIN, 256).decode("ascii", "ignore")

    @contextmanager
    def terminal_restored() -> Iterator[None]:
        """Restore the terminal's modes at the end of a `with`, however it ends."""
        saved = termios.tcgetattr(STDIN) if os.isatty(STDIN) else None
        try:
            yield
        finally:
            if saved is not None and _in_foreground():
                termios.tcsetattr(STDIN, termios.TCSANOW, saved)

    def _in_foreground() -> bool:
        try:
            return os.isatty(STDIN) and os.tcgetpgrp(STDIN) == os.getpgrp()
        except OSError:  # the terminal is of another session
            return False
