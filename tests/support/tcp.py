"""TCP over an emulated link, for its tests."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.support.netem import EmulatedLink, unavailable
from tests.support.netem.namespace import Namespace

PORT = 5000
PATIENCE_S = 20.0
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


@contextmanager
def connected(link: EmulatedLink, number: int = 0) -> Iterator[tuple[socket.socket, socket.socket]]:
    """Provide the ends of a TCP connection over a link, at the sensing node and the display."""
    with link.sensing.entered():
        listener = socket.create_server((link.sensing.addresses[number], PORT))
    with listener:
        with link.display.entered():
            display = socket.create_connection(listener.getsockname(), timeout=PATIENCE_S)
        sensing, _ = listener.accept()
    with sensing, display:
        for end in (sensing, display):
            end.settimeout(PATIENCE_S)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield sensing, display


def stream(
    sensing: socket.socket, display: socket.socket, messages: int, step_ms: float
) -> tuple[list[int], list[int]]:
    """Send one-byte messages; return when each was sent and when it was read, in ns."""
    sent_ns: list[int] = []

    def send() -> None:
        for number in range(messages):
            sent_ns.append(time.perf_counter_ns())
            sensing.sendall(bytes([number % 256]))
            time.sleep(step_ms * 1e-3)

    sender = threading.Thread(target=send)
    sender.start()
    read_ns: list[int] = []
    try:
        while len(read_ns) < messages:
            data, now_ns = display.recv(4096), time.perf_counter_ns()
            assert data == bytes((len(read_ns) + i) % 256 for i in range(len(data)))
            read_ns += [now_ns] * len(data)
    finally:
        sender.join()
    return sent_ns, read_ns
