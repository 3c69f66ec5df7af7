"""A process beside a node, for what would hold up its loop: it is ready before the node moves, is
told what it needs, and ends with the node however that ends.

The two talk in lines of JSON: it says once that it is ready, or why it cannot; its standard input
ends with the node, kill -9 included.
"""

import json
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import entry_points
from subprocess import PIPE
from typing import Any

from protocol.errors import ProcessError, SidecarError, TelepulseError
from protocol.host.child_process import ChildProcess

# The group of entry points (pyproject.toml) by which a node finds what it starts beside itself.
SIDECARS = "telepulse.sidecars"
STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 5.0
# The loop comes first.
NICENESS = 10


class Sidecar:
    """A process that runs beside the node. said: what it told when it was ready."""

    def __init__(
        self,
        what: str,
        module: str,
        *arguments: str,
        log: Callable[[str], None],
        warn: Callable[[str], None],
    ) -> None:
        """what: its name for people. log is told what it says later, warn when it ends before the
        node does.

        Returns once it is ready. Raises BesideError with its reason where it cannot begin.
        """
        self._what, self._log, self._warn = what, log, warn
        self._ending = False
        self._process = ChildProcess(what, "-m", module, *arguments, stdin=PIPE, stdout=PIPE)
        try:
            self.said = self._hear()
        except BaseException:
            self._close()
            raise
        # It waits in the kernel, and wakes when something is said.
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def tell(self, **words: Any) -> None:
        """Tell it something; where it has ended meanwhile, that is said already."""
        with suppress(OSError):
            self._process.write_line(json.dumps(words))

    def end(self) -> None:
        """End it, and wait until it has."""
        self._ending = True
        self._process.close_input()
        self._watcher.join(ENDS_WITHIN_S)
        self._close()

    def _hear(self) -> str:
        try:
            words = json.loads(self._process.read_line(STARTS_WITHIN_S))
        except (ProcessError, ValueError):
            raise SidecarError(f"{self._what} cannot be started") from None
        if "ready" not in words:
            raise SidecarError(words["error"])
        return str(words["ready"])

    def _watch(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._log(_said(line))
        status = self._process.wait()
        if not self._ending:
            self._warn(f"{self._what} has ended with status {status}; the node goes on without")

    def _close(self) -> None:
        with self._process:
            self._process.kill()


def sidecar_module(name: str) -> str:
    """Return the module to run for a sidecar that a package above the nodes provides.

    Parameters
    ----------
    name
        Of an entry point in the group `SIDECARS`, such as "metrics".

    Raises
    ------
    SidecarError
        When no installed package provides it.
    """
    for entry in entry_points(group=SIDECARS, name=name):
        return entry.module
    raise SidecarError(f"no installed package provides {name!r}; pip install telepulse, again")


@contextmanager
def start_sidecar(
    program: str, what: str, module: str, *arguments: str, log: Callable[[str], None]
) -> Iterator[Sidecar]:
    """A companion of the node `program` within a `with`; log is told what it says. Raises
    BesideError."""

    def warn(text: str) -> None:
        print(f"{program}: {text}", file=sys.stderr)

    companion = Sidecar(what, module, *arguments, log=log, warn=warn)
    try:
        yield companion
    finally:
        companion.end()


@contextmanager
def run_as_sidecar() -> Iterator[Callable[[str], None]]:
    """Yield a callback that reports readiness; a TelepulseError is reported and ends the process.
    Called by the process itself.

    It gives way to the node's loop.
    """
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    try:
        yield lambda text: print(json.dumps({"ready": text}), flush=True)
    except TelepulseError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        raise SystemExit(1) from None


def say(text: str) -> None:
    """Have the node print something for people. Called by the process itself."""
    with suppress(OSError):  # the node may have gone
        print(json.dumps({"says": text}), flush=True)


def receive() -> dict[str, Any] | None:
    """Return the node's next message; None when the node has ended. Called by the process
    itself."""
    line = sys.stdin.readline()
    words: dict[str, Any] | None = json.loads(line) if line.endswith("\n") else None
    return words


def _said(line: str) -> str:
    """Return what a sidecar's line is to say; one that a library of it printed is said as it is."""
    try:
        return str(json.loads(line)["says"])
    except (ValueError, TypeError, KeyError):
        return line.rstrip()
