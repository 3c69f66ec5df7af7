"""Nodes run as processes of their own, their summaries and addresses for them.

`protocol.host.child_process` is beneath; both nodes use it for the processes beside them.
"""

import itertools
import json
import logging
import os
import random
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from logging import WARNING
from pathlib import Path
from socket import AF_INET, SOCK_STREAM, socket
from subprocess import PIPE
from threading import Thread
from typing import Any

from display_node.verdict import NOT_VALID_STATUS
from protocol.errors import ProcessError
from protocol.host.child_process import ChildProcess
from protocol.host.output import LOG_AS_JSON, read_record
from protocol.summary.fields import Summary, read_summary

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"
NICEST = -20
# Below the range of ephemeral ports: a node that connects to a port of that range before its peer
# has bound it may get the same port for its own end, and is then connected to itself.
PORTS = range(15_000, 32_000, 2)
# A port is returned again only after all others, since its user binds it some time later.
_ports = itertools.cycle(random.SystemRandom().sample(PORTS, len(PORTS)))


def free_addresses(count: int) -> list[str]:
    """Return different loopback addresses whose port and the next one are free."""
    addresses: list[str] = []
    with ExitStack() as held:
        while len(addresses) < count:
            port = next(_ports)
            try:
                for number in (port, port + 1):
                    holder = held.enter_context(socket(AF_INET, SOCK_STREAM))
                    holder.bind((HOST, number))
            except OSError:
                continue
            addresses.append(f"tcp://{HOST}:{port}")
    return addresses


def prefer(pid: int) -> None:
    """Give a process the highest priority, where it may be had: an emulated board's time counts."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, NICEST)
        # A priority counts within a session; this is that of the session.
        Path(f"/proc/{pid}/autogroup").write_text(f"{NICEST}", "utf-8")


class LoggedProcess(ChildProcess):
    """A process of this project whose warnings and errors are logged, under its name, as they come.

    Latched faults are not: the end of the run names them. Its output is not read.
    """

    def __init__(self, name: str, *arguments: str) -> None:
        environment = {**os.environ, LOG_AS_JSON: "1"}
        super().__init__(name, *arguments, stdout=PIPE, stderr=PIPE, env=environment)
        # `communicate` reads only what is still there.
        self._errors, self.stderr = self.stderr, None
        self._printed: list[str] = []
        self._reader = Thread(target=self._log, name=name, daemon=True)
        self._reader.start()

    def await_end(self, within_s: float, may_end_with: Sequence[int] = ()) -> str:
        """See `ChildProcess.await_end`."""
        super().await_end(within_s, may_end_with)
        self._reader.join()
        return "".join(self._printed)

    def _log(self) -> None:
        assert self._errors is not None
        with self._errors as lines:
            for line in lines:
                record = read_record(line)
                self._printed.append(line if record is None else f"{record.text}\n")
                if record is not None and record.level >= WARNING and not record.names_fault:
                    logger.log(record.level, f"{self.name}: {record.text}")

    def _failure(self, what: str, errors: str | None = None) -> ProcessError:
        self.kill()
        self._reader.join()
        return super()._failure(what, "".join(self._printed))


class NodeProcess(ChildProcess):
    """A node's process, which writes the figures of its run to a file.

    name: its name in errors. module: the node's command line, "sensing_node.cli" or
    "display_node.cli". arguments: those of that command. summary: file for its summary (`--json`).
    options: those of `ChildProcess`: streams, environment and current folder.
    """

    def __init__(
        self, name: str, module: str, *arguments: str, summary: Path, **options: Any
    ) -> None:
        super().__init__(name, "-m", module, *arguments, "--json", str(summary), **options)
        self._summary = summary

    def await_summary(self, within_s: float, may_end_with: Sequence[int] = ()) -> Summary:
        """Wait for the node to end and return its summary.

        A display whose run is not valid has a summary too, which shows that.

        Raises ProcessError when it does not end in time, or fails; see `await_end`.
        """
        self.await_end(within_s, (NOT_VALID_STATUS, *may_end_with))
        return read_summary(json.loads(self._summary.read_text(encoding="utf-8")))


class LoggedNode(NodeProcess, LoggedProcess):
    """A node's process that is logged: for example, a drive's asks for a free bench."""
