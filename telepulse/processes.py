"""A node that runs as a process of its own: how it ended, and what it summed up.

Free addresses on this machine, for nodes that are started together.
"""

import itertools
import json
import random
import subprocess
from contextlib import ExitStack
from pathlib import Path
from socket import AF_INET, SOCK_STREAM, socket

from pydantic import TypeAdapter

from protocol.errors import TelepulseError
from protocol.run_summary import Summary

HOST = "127.0.0.1"
# Below the ports that systems give to outgoing connections: a node that connects to one of those
# before its peer has bound it can be given that very port, and then connects to itself.
PORTS = range(15_000, 32_000, 2)
# None is given again soon: who was given it need not have bound it yet.
_ports = itertools.cycle(random.SystemRandom().sample(PORTS, len(PORTS)))


def free_addresses(count: int) -> list[str]:
    """Different loopback addresses whose port and the next one nobody holds."""
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


class NodeError(TelepulseError, RuntimeError):
    """A node's process failed, or did not end."""


def await_end(
    process: subprocess.Popen[str], name: str, seconds: float, *, may_end_with: int = 0
) -> None:
    """Wait for a process to end well within `seconds`. Raises NodeError with its last line.

    may_end_with: a further exit status that is no failure of the process.
    """
    try:
        _, errors = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        raise NodeError(f"the {name} did not end within {seconds:.0f} s") from None
    if process.returncode not in (0, may_end_with):
        last = errors.strip().splitlines()[-1:] or ["it said nothing"]
        raise NodeError(f"the {name} ended with status {process.returncode}: {last[0]}")


def read_summary(path: Path) -> Summary:
    """The summary that a node wrote with --json."""
    return _SUMMARY.validate_python(json.loads(path.read_text(encoding="utf-8")))
