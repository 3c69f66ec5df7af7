"""Output of a program: its log, standard streams that never block it, result files.

A write blocks at a terminal stopped by Ctrl-S, a pager that does not read on, or a full pipe. It
raises at a closed pipe or a full disk. While a node's main thread is blocked, no display is served,
no drive is commanded and no signal is handled. So a node's output passes through a bounded queue
(`unblocked_output`), and a separate thread writes it.
"""

import io
import json
import logging
import os
import queue
import secrets
import signal
import stat
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple, TextIO, cast

from protocol.errors import OptionError, OutputError
from protocol.host.descriptors import await_writable

LEVELS = ("debug", "info", "warning", "error")
# A module run by `python -m` logs as `__main__`.
OUR_LOGGERS = (
    "protocol",
    "pulse_sensors",
    "pulse_drives",
    "sensing_node",
    "display_node",
    "telepulse",
    "__main__",
)
# Attribute of a log record that names a latched fault: `extra={FAULT: True}`.
FAULT = "fault"
# Greatest number of queued characters: some seconds of a terminal panel, many summaries.
MAX_QUEUED = 65_536
# Longest waits for queued text at the end: without progress, and in all.
STUCK_S = 1.0
CLOSE_WITHIN_S = 5.0
_LOOK_EVERY_S = 0.02


def escaped(text: str) -> str:
    """Return a text for a line of a terminal: its control characters would change the screen."""
    if text.isprintable():
        return text
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode("ascii")
        for each in text
    )


class LineFormatter(logging.Formatter):
    """Formatter of a record as one line of printable characters."""

    def format(self, record: logging.LogRecord) -> str:
        """Return `HH:MM:SS.mmm LEVEL message` in local time; control characters are escaped.

        The date comes first where the log goes to no terminal: a file is read on another day.
        """
        date = "" if sys.stderr.isatty() else "%Y-%m-%d "
        at = time.strftime(f"{date}%H:%M:%S", time.localtime(record.created))
        text = record.getMessage()
        if record.exc_info is not None:
            kind, error, trace = record.exc_info
            text += f": {getattr(kind, '__name__', kind)}: {error}"
            # The innermost line of the traceback.
            for frame in traceback.extract_tb(trace)[-1:]:
                text += f" ({frame.filename}:{frame.lineno})"
        return f"{at}.{int(record.msecs):03d} {record.levelname} {escaped(text)}"


# A program that reads this one's log sets it, to any text.
LOG_AS_JSON = "TELEPULSE_LOG_AS_JSON"


class JsonFormatter(logging.Formatter):
    """Formatter of a record as one line of JSON, for a program that reads it (`read_record`)."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record's level and text, and whether it names a latched fault."""
        fields = {"level": record.levelname, "text": record.getMessage()}
        return json.dumps(fields | ({FAULT: True} if hasattr(record, FAULT) else {}))


class LoggedRecord(NamedTuple):
    """A record of another program's log; names_fault: it is about a latched fault."""

    level: int
    text: str
    names_fault: bool


def read_record(line: str) -> LoggedRecord | None:
    """Return the record of a line of `JsonFormatter`; None for another line."""
    try:
        fields = json.loads(line)
        level = logging.getLevelNamesMapping()[fields["level"]]
        return LoggedRecord(level, str(fields["text"]), FAULT in fields)
    except (ValueError, TypeError, KeyError):
        return None


class StderrHandler(logging.Handler):
    """Handler that writes records to the present `sys.stderr`."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line; errors, for example of a reader that has gone, are ignored."""
        with suppress(OSError, ValueError):
            sys.stderr.write(self.format(record) + "\n")


def configure_logging(level: str | None = None, quiet: bool = False) -> None:
    """Log to standard error, one line a record; call it again to change the level.

    level: one of `LEVELS`; None stands for "warning" with `quiet`, else for "info". Raises
    OptionError for an unknown level.
    """
    name = level or ("warning" if quiet else "info")
    if name not in LEVELS:
        raise OptionError(f"--log-level {name}: there are {', '.join(LEVELS)}")
    number = logging.getLevelNamesMapping()[name.upper()]
    root = logging.getLogger()
    handler = next((each for each in root.handlers if isinstance(each, StderrHandler)), None)
    if handler is None:
        handler = StderrHandler()
        handler.setFormatter(JsonFormatter() if LOG_AS_JSON in os.environ else LineFormatter())
        root.addHandler(handler)
    # Some libraries set the level of their own logger when they are imported.
    handler.setLevel(number)
    # Of libraries, only warnings and errors are shown.
    root.setLevel(max(number, logging.WARNING))
    # The drive raises or counts what canopen logs.
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    for ours in OUR_LOGGERS:
        logging.getLogger(ours).setLevel(number)


class QueuedStream(io.TextIOBase):
    """A text stream whose `write` always returns at once.

    If the queue is full or the text cannot be written, it is dropped and its lines are counted. The
    count is written as a separate line when output is possible again. Only the target's descriptor
    and encoding are used. Its buffer is not, since a buffer with text would block the interpreter's
    end.
    """

    def __init__(self, target: TextIO) -> None:
        self._target = target
        self._number = target.fileno()
        self._queue: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        # Reentrant, because a signal handler may print during a print.
        self._lock = threading.RLock()
        # Characters. The first changes under the lock, the second only in the writing thread.
        self._given = self._taken = 0
        # Lines; the first changes under the lock, the others only in the writing thread.
        self._refused = self._lost = self._reported = 0
        self._at_line_start = True
        self._thread = threading.Thread(target=self._write_all, name="output", daemon=True)
        self._thread.start()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The target's encoding."""
        return self._target.encoding

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
        """Queue `text`, or drop it if too much is queued already."""
        # click tests whether a stream accepts bytes.
        if not isinstance(text, str):
            raise TypeError(f"text is written, not {type(text).__name__}")
        with self._lock:
            if self._given - self._taken >= MAX_QUEUED:
                self._refused += _lines(text)
            else:
                self._given += len(text)
                self._queue.put(text)
        return len(text)

    def flush(self) -> None:
        """Do nothing: the writing thread writes as soon as it can."""

    def finish(self) -> None:
        """Wait until all text is written, at most 1 s without progress and 5 s in all."""
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
        """Write text, blocking; return False if it cannot be written."""
        data = text.encode(self.encoding, "backslashreplace")
        try:
            while data:
                try:
                    data = data[os.write(self._number, data) :]
                except BlockingIOError:
                    # Another process has made the shared descriptor non-blocking.
                    await_writable(self._number, None)
        except (OSError, ValueError):
            return False
        if text:
            self._at_line_start = text.endswith("\n")
        return True


def _lines(text: str) -> int:
    return max(1, text.count("\n"))


@contextmanager
def unblocked_output() -> Iterator[None]:
    """Queue everything that is printed within the `with`; separate threads write it.

    Use it in the main thread of a program that must not block on its output. A replaced
    `sys.stdout`, as in a test's capture, is left alone.
    """
    if sys.platform == "win32":  # its consoles do not take text by a descriptor
        yield
        return
    # With `stty tostop`, SIGTTOU would stop a program that prints in the background.
    tostop = signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    with ExitStack() as until_the_end:
        until_the_end.callback(signal.signal, signal.SIGTTOU, tostop)
        for name in ("stderr", "stdout"):
            target: TextIO | None = getattr(sys, name)
            if target is not None and target is getattr(sys, f"__{name}__"):
                stream = QueuedStream(target)
                setattr(sys, name, cast(TextIO, stream))
                until_the_end.callback(stream.finish)
                until_the_end.callback(setattr, sys, name, target)
        try:
            yield
        except Exception:
            # Printed here, since the interpreter would write it directly, and might block.
            sys.excepthook(*sys.exc_info())
            raise SystemExit(1) from None


# The file that stands for standard output.
STDOUT = Path("-")


def check_writable(path: Path | None) -> None:
    """Check before a run that its result can be written to `path`; None and `STDOUT` pass.

    An existing file is not changed. Raises OutputError.
    """
    if path is None or path == STDOUT:
        return
    with _refusals(path):
        if not path.parent.is_dir():
            raise OSError(0, f"the folder {path.parent} does not exist")
        # Opening a pipe would wait for its reader.
        special = _is_special(path)
        if not special:
            _draft(path).unlink()
        if (special or path.exists()) and not os.access(path, os.W_OK):
            raise OSError(0, "it is read-only")


def write_whole(path: Path, text: str) -> None:
    """Write a text file in one step: readers see either the old file or the whole new one.

    A link stays one, and an existing file keeps its mode, and its owner where this user may set it.
    A pipe or a device is written directly; text for `STDOUT` is printed. Raises OutputError.
    """
    if path == STDOUT:
        print(text, end="")
        return
    with _refusals(path):
        if _is_special(path):
            path.write_text(text, encoding="utf-8")
            return
        draft = _draft(path)
        try:
            with draft.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path.resolve())
        except BaseException:
            draft.unlink(missing_ok=True)
            raise


def create_file(path: Path, text: str, mode: int = 0o666) -> None:
    """Write a new text file that has its `mode` from the first byte on.

    A file that cannot be written completely is removed. Raises OutputError, also if it exists.
    """
    with _refusals(path):
        try:
            number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        except FileExistsError:
            raise OutputError(f"{path}: exists already; name another file") from None
        try:
            with open(number, "w", encoding="utf-8") as file:
                file.write(text)
        except OSError:
            path.unlink(missing_ok=True)
            raise


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


def _is_special(path: Path) -> bool:
    """Return whether the path is a pipe or a device. Raises OSError for a folder."""
    with suppress(FileNotFoundError):
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(0, "it is a folder")
        return not stat.S_ISREG(mode)
    return False


def _draft(path: Path) -> Path:
    """Return a new, empty file beside `path`, with the owner and the permissions of `path`."""
    target = path.resolve()
    draft = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    draft.open("xb").close()
    if target.exists():
        status = target.stat()
        if sys.platform != "win32":
            with suppress(PermissionError):
                os.chown(draft, status.st_uid, status.st_gid)
        draft.chmod(stat.S_IMODE(status.st_mode))
    return draft
