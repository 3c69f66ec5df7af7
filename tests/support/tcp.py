"""TCP ports within namespaces, and the mark of tests that need the link emulator."""

import socket
from contextlib import suppress
from pathlib import Path

import pytest

from tests.support.netem import unavailable
from tests.support.netem.namespace import Namespace

reason = unavailable()
needs_emulator = pytest.mark.skipif(reason is not None, reason=str(reason))


def retransmissions(pid: int, port: int) -> int:
    """Return how often TCP has repeated the unacknowledged data of a process's port."""
    lines = Path(f"/proc/{pid}/net/tcp").read_text(encoding="ascii").splitlines()[1:]
    sockets = [line.split() for line in lines]
    return max((int(s[6], 16) for s in sockets if s[1].endswith(f":{port:04X}")), default=0)


def answers(namespace: Namespace, host: str, port: int) -> bool:
    """Return whether a port accepts connections from within a namespace."""
    with namespace.entered(), suppress(OSError), socket.create_connection((host, port), 1):
        return True
    return False
