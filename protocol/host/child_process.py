"""Child processes: Python programs that run on their own, and processes beside a node (sidecars).

A child does not search the current folder for modules (`python -P`): a `protocol.py` there would
be imported in place of ours. A sidecar does work that would delay a node's loop. It is ready
before a drive moves. It ends when its standard input is closed, which the end of the node causes
even after `kill -9`. The two exchange lines of JSON over pipes; the sidecar's first line reports
that it is ready, or the reason why it cannot start.
"""

import json
import logging
import os
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import entry_points
from typing import Any, Self

from protocol.errors import ProcessError, SidecarError, TelepulseError
from protocol.host.output import OUR_LOGGERS, JsonFormatter, read_record
from protocol.host.process import lower_priority

logger = logging.getLogger(__name__)

# The group of entry points (pyproject.toml) by which a node finds what it starts beside itself.
SIDECARS = "telepulse.sidecars"
STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 5.0


def python_command(*arguments: str) -> list[str]:
    """Return the command that starts this interpreter with arguments, such as "-m" and a module."""
    return [sys.executable, "-P", *arguments]


class ChildProcess(subprocess.Popen[str]):
    """A process that this interpreter runs; within a `with`, it is killed at the end.

    name: used in error messages. arguments: those of the interpreter, such as "-m", a module and
    the module's arguments. own_session: Ctrl-C at the terminal is not sent to the child; this
    process ends it. ends_with_parent: it receives SIGTERM when this process ends, even by `kill -9`
    (Linux); otherwise it can do what is left when its input ends. options: those of
    `subprocess.Popen`.
    """

    def __init__(
        self,
        name: str,
        *arguments: str,
        own_session: bool = True,
        ends_with_parent: bool = True,
        **options: Any,
    ) -> None:
        self.name = name
        command = python_command(*arguments)
        options |= {"start_new_session": own_session, "encoding": "utf-8"}
        if sys.platform != "linux" or not ends_with_parent:
            super().__init__(command, **options)
            return
        reader, writer = os.pipe()
        weakref.finalize(self, os.close, writer)
        try:
            options["pass_fds"] = (*options.get("pass_fds", ()), reader)
            super().__init__(command, **options)
            _terminate_at_end_of(reader, self.pid)
        finally:
            os.close(reader)

    def __exit__(self, *raised: Any) -> None:
        self.kill()
        with suppress(BrokenPipeError):
            super().__exit__(*raised)

    def read_line(self, within_s: float, from_stderr: bool = False) -> str:
        """Return the next line from the process's stdout or stderr, without the line's end.

        Raises ProcessError where the process ends first, or is killed as it writes none in time.
        """
        stream = self.stderr if from_stderr else self.stdout
        assert stream is not None
        expired = threading.Event()

        def expire() -> None:
            expired.set()
            self.kill()

        timer = threading.Timer(within_s, expire)
        timer.start()
        try:
            line = stream.readline()
        finally:
            timer.cancel()
        if not line:
            silent = f"printed nothing for {within_s:g} s"
            raise self._failure(silent if expired.is_set() else "ended")
        return line.rstrip("\n")

    def close_input(self) -> None:
        """Close the process's standard input, where it has not ended already."""
        if self.stdin is not None:
            with suppress(BrokenPipeError):
                self.stdin.close()
            # `communicate` would flush the closed input, and fail.
            self.stdin = None

    def stop(self, within_s: float = ENDS_WITHIN_S) -> int:
        """Terminate the process, kill it when it does not end in time; return its exit status."""
        self.terminate()
        try:
            self.communicate(timeout=within_s)
        except subprocess.TimeoutExpired:
            self.kill()
            self.communicate()
        return self.returncode

    def check(self, may_end_with: Sequence[int] = ()) -> None:
        """Raise ProcessError where the process has ended, with none of the named statuses."""
        if self.poll() not in (None, *may_end_with):
            raise self._failure(f"ended early with status {self.returncode}")

    def await_end(self, within_s: float, may_end_with: Sequence[int] = ()) -> str:
        """Wait up to `within_s` for the process to end; return what it wrote to a piped stderr.

        Raises ProcessError with its last error line when it does not end in time, or with another
        status than 0 and those of `may_end_with`.
        """
        try:
            _, errors = self.communicate(timeout=within_s)
        except subprocess.TimeoutExpired:
            raise ProcessError(f"the {self.name} did not end within {within_s:.0f} s") from None
        if self.returncode not in (0, *may_end_with):
            raise self._failure(f"ended with status {self.returncode}", errors)
        return errors or ""

    def _failure(self, what: str, errors: str | None = None) -> ProcessError:
        """Return an error that names the failure and the process's last error line."""
        if errors is None:
            self.kill()
            _, errors = self.communicate()
        last = (errors or "").strip().splitlines()[-1:] or ["it printed no reason"]
        return ProcessError(f"the {self.name} {what}: {last[0]}")


def _terminate_at_end_of(reader: int, pid: int) -> None:
    """Let the kernel send SIGTERM to a process when the last writer of a pipe has closed it.

    The process inherits the pipe's end for reading, and does nothing with it. The signal that a
    kernel offers at a parent's death (PR_SET_PDEATHSIG) comes when the starting thread ends.
    """
    import fcntl

    fcntl.fcntl(reader, fcntl.F_SETOWN, pid)
    fcntl.fcntl(reader, fcntl.F_SETSIG, signal.SIGTERM)
    fcntl.fcntl(reader, fcntl.F_SETFL, fcntl.fcntl(reader, fcntl.F_GETFL) | os.O_ASYNC)


class Sidecar:
    """A process that runs beside the node within a `with`; it is ready after construction.

    Its log records appear in the node's log under its `name`, such as "announcer". module: the
    module to run; it calls `run_as_sidecar`. ready_message: the text that it sent when it was
    ready. Raises SidecarError with the reason when it cannot start.
    """

    def __init__(self, name: str, module: str, *arguments: str) -> None:
        self._name = name
        self._ending = False
        pipe = subprocess.PIPE
        # It ends with its input, after its last work: a recording's end, a withdrawn announcement.
        self._process = ChildProcess(
            name, "-m", module, *arguments, ends_with_parent=False, stdin=pipe, stdout=pipe
        )
        try:
            message = json.loads(self._process.read_line(STARTS_WITHIN_S))
            if "ready" not in message:
                raise SidecarError(message["error"])
        except (ProcessError, ValueError):
            self._close()
            raise SidecarError(f"the {name} cannot be started") from None
        except BaseException:
            self._close()
            raise
        self.ready_message = str(message["ready"])
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def send(self, **message: Any) -> None:
        """Send a message. Does nothing where the process has ended; its end was logged."""
        with suppress(OSError):
            print(json.dumps(message), file=self._process.stdin, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ending = True
        self._process.close_input()
        self._reader.join(ENDS_WITHIN_S)
        self._close()

    def _read(self) -> None:
        """Log the process's records under its name; other lines, as libraries print, as info."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            record = read_record(line)
            level, text = (logging.INFO, line.rstrip()) if record is None else record[:2]
            logger.log(level, f"{self._name}: {text}")
        status = self._process.wait()
        if not self._ending:
            logger.warning(
                f"the {self._name} has ended with status {status}; the node continues without it"
            )

    def _close(self) -> None:
        with self._process:
            self._process.kill()


def sidecar_module(name: str) -> str:
    """Return the module of a sidecar that an installed package provides.

    name: an entry point in the group `SIDECARS`, such as "metrics". Raises SidecarError when no
    installed package provides it.
    """
    for entry in entry_points(group=SIDECARS, name=name):
        return entry.module
    raise SidecarError(f"no installed package provides {name!r}; pip install telepulse, again")


@contextmanager
def run_as_sidecar() -> Iterator[Callable[[str], None]]:
    """Yield a callback that reports readiness to the node.

    A TelepulseError is reported as well and ends the process with status 1. The process lowers its
    own priority, so that the node's loop comes first.
    """
    lower_priority()
    handler = _NodeHandler()
    handler.setFormatter(JsonFormatter())
    logging.getLogger().addHandler(handler)
    for ours in OUR_LOGGERS:
        # All records are sent; the node drops those below its own level.
        logging.getLogger(ours).setLevel(logging.DEBUG)
    try:
        yield lambda text: print(json.dumps({"ready": text}), flush=True)
    except TelepulseError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        raise SystemExit(1) from None


class _NodeHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):  # the node may have gone
            print(self.format(record), flush=True)


def receive() -> dict[str, Any] | None:
    """Return the node's next message; None when the node has ended."""
    line = sys.stdin.readline()
    message: dict[str, Any] | None = json.loads(line) if line.endswith("\n") else None
    return message
