"""A process beside a node for work that would hold up its loop.

It is ready before the node moves, receives messages from it, and ends with it however that ends.
The two exchange lines of JSON over pipes: the sidecar sends once that it is ready, or why it cannot
start; its standard input closes when the node ends, `kill -9` included.
"""

import json
import logging
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
from protocol.host.output import OUR_LOGGERS

logger = logging.getLogger(__name__)

# The group of entry points (pyproject.toml) by which a node finds what it starts beside itself.
SIDECARS = "telepulse.sidecars"
STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 5.0
# The loop comes first.
NICENESS = 10


class Sidecar:
    """A process that runs beside the node, ready once this is constructed.

    Parameters
    ----------
    name : str
        Its name in the node's log, such as "announcer".
    module : str
        Module that it runs, which calls `run_as_sidecar`.
    *arguments : str
        Its command-line arguments.

    Attributes
    ----------
    ready_message : str
        Text that it sent when it was ready.

    Raises
    ------
    SidecarError
        With its reason, when it cannot start.
    """

    def __init__(self, name: str, module: str, *arguments: str) -> None:
        self._name = name
        self._ending = False
        self._process = ChildProcess(name, "-m", module, *arguments, stdin=PIPE, stdout=PIPE)
        try:
            self.ready_message = self._wait_until_ready()
        except BaseException:
            self._close()
            raise
        # It waits in the kernel, and wakes when a line comes.
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def send(self, **message: Any) -> None:
        """Send a message; nothing is sent to a process that has ended, which is logged."""
        with suppress(OSError):
            self._process.write_line(json.dumps(message))

    def end(self) -> None:
        """End the process, and wait until it has ended."""
        self._ending = True
        self._process.close_input()
        self._reader.join(ENDS_WITHIN_S)
        self._close()

    def _wait_until_ready(self) -> str:
        try:
            message = json.loads(self._process.read_line(STARTS_WITHIN_S))
        except (ProcessError, ValueError):
            raise SidecarError(f"the {self._name} cannot be started") from None
        if "ready" not in message:
            raise SidecarError(message["error"])
        return str(message["ready"])

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            level, text = _read_record(line)
            logger.log(level, f"{self._name}: {text}")
        status = self._process.wait()
        if not self._ending:
            logger.warning(
                f"the {self._name} has ended with status {status}; the node goes on without"
            )

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
def start_sidecar(name: str, module: str, *arguments: str) -> Iterator[Sidecar]:
    """Run a sidecar within a `with`; what it logs is logged here under its name.

    The parameters are those of `Sidecar`. Raises SidecarError.
    """
    sidecar = Sidecar(name, module, *arguments)
    try:
        yield sidecar
    finally:
        sidecar.end()


# Below: called by the process itself.


@contextmanager
def run_as_sidecar() -> Iterator[Callable[[str], None]]:
    """Yield a callback that reports readiness; report a TelepulseError, and exit with status 1.

    The process gives way to the node's loop (`nice`).
    """
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    logging.getLogger().addHandler(_NodeHandler())
    for ours in OUR_LOGGERS:
        # The node drops the records below its own level.
        logging.getLogger(ours).setLevel(logging.DEBUG)
    try:
        yield lambda text: print(json.dumps({"ready": text}), flush=True)
    except TelepulseError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        raise SystemExit(1) from None


class _NodeHandler(logging.Handler):
    """Send the records of this process to the node."""

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):  # the node may have gone
            fields = {"level": record.levelname, "text": record.getMessage()}
            print(json.dumps(fields), flush=True)


def receive() -> dict[str, Any] | None:
    """Return the node's next message; None when the node has ended."""
    line = sys.stdin.readline()
    message: dict[str, Any] | None = json.loads(line) if line.endswith("\n") else None
    return message


def _read_record(line: str) -> tuple[int, str]:
    """Return the level and text of a sidecar's line; "info" for one that a library printed."""
    try:
        record = json.loads(line)
        return logging.getLevelNamesMapping()[record["level"]], str(record["text"])
    except (ValueError, TypeError, KeyError):
        return logging.INFO, line.rstrip()
