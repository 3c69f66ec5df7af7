"""Nodes run as processes of their own, their summaries and addresses for them.

`protocol.host.child_process` is beneath; both nodes use it for the processes beside them.
"""

import itertools
import json
import logging
import os
import random
import re
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from socket import AF_INET, SOCK_STREAM, socket
from typing import Any

from pydantic import TypeAdapter

from display_node.verdict import NOT_VALID_STATUS
from protocol.host.child_process import ChildProcess
from protocol.summary.tables import Summary

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"
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


_SUMMARY = TypeAdapter(Summary)
# Log lines of a process that its user should see. Faults are not: the end of the run names them.
_WARNING = re.compile(
    r"^\d\d:\d\d:\d\d\.\d{3} (WARNING|ERROR|CRITICAL) (?!fault: )(.*)$", re.MULTILINE
)


def log_warnings(name: str, errors: str) -> None:
    """Log the warnings and errors of a process's log, under the process's name."""
    for level, text in _WARNING.findall(errors):
        logger.log(logging.getLevelNamesMapping()[level], f"{name}: {text}")


def cpu_time_s(pid: int) -> float:
    """Return the processor time that all threads of a process have used. Linux."""
    # The name, in parentheses, may contain spaces; times in user and system mode are 11 and 12
    # fields after it.
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class NodeProcess(ChildProcess):
    """A node's process, which writes its closing summary to a file.

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
        """Wait for the node to end, log its warnings and return its summary.

        A display whose run is not valid has a summary too, which shows that.

        Raises ProcessError when it does not end in time, or fails; see `await_end`.
        """
        log_warnings(self.name, self.await_end(within_s, (NOT_VALID_STATUS, *may_end_with)))
        return _SUMMARY.validate_python(json.loads(self._summary.read_text(encoding="utf-8")))
