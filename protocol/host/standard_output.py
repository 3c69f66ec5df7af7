"""Standard output and standard error that never hold up or end a running node.

A terminal stopped by Ctrl-S, a pager that does not read on or a full pipe blocks whoever writes;
a closed pipe or a full disk raises. Neither may meet a node: while its main thread is in a write,
nothing is served, no drive is commanded and no signal is obeyed. So what a node prints passes
through a bounded queue, and a thread that nobody waits for writes it out.
"""

import io
import os
import queue
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TextIO, cast

# Some seconds of a terminal panel, and far more than a summary.
MAX_QUEUED = 65_536
# At the end: how long to wait for what is queued while nothing of it is taken, and in all.
STUCK_S = 1.0
CLOSE_WITHIN_S = 5.0
_LOOK_EVERY_S = 0.02


class QueuedStream(io.TextIOBase):
    """A text stream whose `write` returns at once, whatever becomes of the text.

    Text that finds the queue full, or that cannot be written, is dropped and its lines are counted.
    The count is written as a line of its own as soon as output is possible again.

    Parameters
    ----------
    target
        The stream whose file descriptor, encoding and terminal are used. Its own buffer is not: a
        buffer with text left in it would block the interpreter's end.
    """

    def __init__(self, target: TextIO) -> None:
        self._target = target
        self._number = target.fileno()
        self._queue: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        # Reentrant, as a signal handler may print in the midst of a print.
        self._lock = threading.RLock()
        # In characters. The first changes under the lock, the second in the writing thread alone.
        self._given = self._taken = 0
        # In lines, likewise.
        self._refused = self._lost = self._reported = 0
        self._at_line_start = True
        self._thread = threading.Thread(target=self._write_all, name="output", daemon=True)
        self._thread.start()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The target's encoding."""
        return self._target.encoding

    @property
    def queued(self) -> int:
        """The number of characters that are not written yet."""
        return self._given - self._taken

    @property
    def dropped(self) -> int:
        """The number of lines that were dropped so far."""
        return self._refused + self._lost

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether the target is a terminal."""
        return self._target.isatty()

    def fileno(self) -> int:
        """Return the target's file descriptor."""
        return self._number

    def write(self, text: str, /) -> int:
        """Queue `text`, or drop it where too much is queued already."""
        # click tries bytes to find out whether a stream takes them.
        if not isinstance(text, str):
            raise TypeError(f"text is written, not {type(text).__name__}")
        with self._lock:
            if self.queued >= MAX_QUEUED:
                self._refused += _lines(text)
            else:
                self._given += len(text)
                self._queue.put(text)
        return len(text)

    def flush(self) -> None:
        """Do nothing: the writing thread writes as soon as it can."""

    def finish(self) -> None:
        """Wait until all is written; give up where nothing can be, and after 5 s in any case."""
        self._queue.put(None)
        begin_s = progress_s = time.monotonic()
        taken = self._taken
        while self._thread.is_alive():
            self._thread.join(_LOOK_EVERY_S)
            now_s = time.monotonic()
            if self._taken != taken:
                taken, progress_s = self._taken, now_s
            if now_s - progress_s > STUCK_S or now_s - begin_s > CLOSE_WITHIN_S:
                return

    def _write_all(self) -> None:
        while (text := self._queue.get()) is not None:
            if not self._write(text):
                self._lost += _lines(text)
            elif self._queue.empty() and self.dropped > self._reported:
                self._report()
            self._taken += len(text)

    def _report(self) -> None:
        dropped = self.dropped
        lines = "1 line" if dropped - self._reported == 1 else f"{dropped - self._reported} lines"
        start = "" if self._at_line_start else "\n"
        if self._write(f"{start}{lines} of output dropped: it could not be written\n"):
            self._reported = dropped

    def _write(self, text: str) -> bool:
        """Write text, however long that takes; return False where it cannot be written."""
        data = text.encode(self.encoding, "backslashreplace")
        try:
            while data:
                try:
                    data = data[os.write(self._number, data) :]
                except BlockingIOError:
                    # Who shares the descriptor has made it non-blocking.
                    select.select((), (self._number,), ())
        except (OSError, ValueError):
            return False
        if text:
            self._at_line_start = text.endswith("\n")
        return True


@contextmanager
def unblocked_output() -> Iterator[None]:
    """Have everything that is printed within the `with` queued and written by threads of its own.

    For the main thread of a program that must go on whoever reads its output. What replaces
    `sys.stdout` already, as a test's capture does, is left alone.
    """
    if sys.platform == "win32":  # whose consoles take text by another way than a descriptor
        yield
        return
    # Else a shell's `stty tostop` stops a program that prints in the background.
    tostop = signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    with ExitStack() as until_the_end:
        until_the_end.callback(signal.signal, signal.SIGTTOU, tostop)
        for name in ("stderr", "stdout"):
            until_the_end.enter_context(_queued(name))
        try:
            yield
        except Exception:
            # Here, as the interpreter would write it straight to where nobody reads.
            sys.excepthook(*sys.exc_info())
            raise SystemExit(1) from None


@contextmanager
def _queued(name: str) -> Iterator[None]:
    """Replace one of the standard streams, where it is the process's own."""
    target: TextIO | None = getattr(sys, name)
    if target is None or target is not getattr(sys, f"__{name}__"):
        yield
        return
    stream = QueuedStream(target)
    setattr(sys, name, cast(TextIO, stream))
    try:
        yield
    finally:
        setattr(sys, name, target)
        stream.finish()


def _lines(text: str) -> int:
    return max(1, text.count("\n"))
