"""A Python program of ours that runs as a process of its own.

It does not search the current folder for modules (`python -P`): a `protocol.py` or a `telepulse.py`
that somebody keeps there would be imported in place of ours.
"""

import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO

from protocol.errors import ProcessError

STOPS_WITHIN_S = 5.0


def python_command(*arguments: str) -> list[str]:
    """Return the command that starts this interpreter with arguments, such as "-m" and a module."""
    return [sys.executable, "-P", *arguments]


class ChildProcess(subprocess.Popen[str]):
    """A process that this interpreter runs; within a `with`, it is killed at the end.

    Parameters
    ----------
    name
        Its name in errors.
    arguments
        Of the interpreter: "-m", a module and that module's arguments.
    stdin, stdout, stderr
        As of `subprocess.Popen`; None: this process's own.
    pass_fds
        Descriptors that stay open in it.
    cwd, env
        Its current folder and its environment; None: this process's.
    own_session
        Ctrl-C at the terminal does not reach it: this process ends it.
    """

    def __init__(
        self,
        name: str,
        *arguments: str,
        stdin: IO[bytes] | int | None = None,
        stdout: IO[bytes] | int | None = None,
        stderr: IO[bytes] | int | None = None,
        pass_fds: Sequence[int] = (),
        cwd: Path | None = None,
        env: Mapping[str, str] | None = None,
        own_session: bool = True,
    ) -> None:
        self.name = name
        super().__init__(
            python_command(*arguments),
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            pass_fds=pass_fds,
            cwd=cwd,
            env=env,
            start_new_session=own_session,
            encoding="utf-8",
        )

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.kill()
        with suppress(BrokenPipeError):
            super().__exit__(kind, error, traceback)

    def read_line(self, within_s: float, log: bool = False) -> str:
        """Return the next line that the process prints, or writes to its log, without its end.

        Raises
        ------
        ProcessError
            When it ends before, or prints none in time and is killed.
        """
        stream = self.stderr if log else self.stdout
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

    def write_line(self, line: str) -> None:
        """Write a line to the process's standard input. Raises OSError when it has ended."""
        assert self.stdin is not None
        self.stdin.write(line + "\n")
        self.stdin.flush()

    def close_input(self) -> None:
        """Close the process's standard input, where it has not ended already."""
        if self.stdin is not None:
            with suppress(BrokenPipeError):
                self.stdin.close()
            # `communicate` would flush it, and fail.
            self.stdin = None

    def stop(self, within_s: float = STOPS_WITHIN_S) -> int:
        """Terminate the process, kill it when it does not end in time; return its exit status."""
        self.terminate()
        try:
            self.communicate(timeout=within_s)
        except subprocess.TimeoutExpired:
            self.kill()
            self.communicate()
        return self.returncode

    def await_end(self, within_s: float, may_end_with: int = 0) -> None:
        """Wait for the process to end.

        Parameters
        ----------
        within_s
            The longest wait, in seconds.
        may_end_with
            A further exit status that is no failure.

        Raises
        ------
        ProcessError
            When it does not end in time, or fails; with its last error line.
        """
        try:
            _, errors = self.communicate(timeout=within_s)
        except subprocess.TimeoutExpired:
            raise ProcessError(f"the {self.name} did not end within {within_s:.0f} s") from None
        if self.returncode not in (0, may_end_with):
            raise self._failure(f"ended with status {self.returncode}", errors)

    def _failure(self, what: str, errors: str | None = None) -> ProcessError:
        """Return the error that names what happened and the process's last error line."""
        if errors is None:
            self.kill()
            _, errors = self.communicate()
        last = (errors or "").strip().splitlines()[-1:] or ["it printed no reason"]
        return ProcessError(f"the {self.name} {what}: {last[0]}")
