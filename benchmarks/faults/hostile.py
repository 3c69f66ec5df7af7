"""Peers that do harm: one that never reads, one that sends garbage, one that sends nothing."""

import random
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import zmq

PATIENCE_S = 10.0
# A node that takes no connections for now drops requests, which are repeated after 1 s.
TURNED_AWAY_S = 2.0
# ZMTP 3.0 without a mechanism, see rfc.zeromq.org/spec/23.
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)
READY_BYTES = 27
SUBSCRIBE_TO_ALL = b"\x00\x01\x01"
# Of what a message is made that is no garbage to ZeroMQ.
MESSAGE_BYTES = (0, 1, 10, 100, 10_000, 60_000)
RAW_BYTES = 2_000
ESTABLISHED = "01"
BURST = 200


def port_of(address: str) -> int:
    """The port of a TCP address."""
    return int(address.rpartition(":")[2])


def deaf_subscriber(port: int, small: bool = True) -> socket.socket:
    """A subscriber to all that a PUB on this machine sends; nothing is read of it, ever.

    It has no ZeroMQ, whose thread would read. small: its buffer is the kernel's smallest.
    """
    connection = socket.socket()
    connection.settimeout(PATIENCE_S)
    if small:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    connection.connect(("127.0.0.1", port))
    _shake_hands(connection)
    connection.sendall(SUBSCRIBE_TO_ALL)
    return connection


def subscribing(port: int, topic_bytes: int, seconds: float) -> None:
    """A peer that subscribes to ever new topics as fast as it can, and connects anew when it is
    cut off.
    """
    end_s, number = time.monotonic() + seconds, 0
    while time.monotonic() < end_s:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), seconds) as one:
            _shake_hands(one)
            while time.monotonic() < end_s:
                topics = (b"%0*d" % (topic_bytes, n) for n in range(number, number + BURST))
                one.sendall(
                    b"".join(b"\2" + struct.pack(">Q", len(t) + 1) + b"\1" + t for t in topics)
                )
                number += BURST


def _shake_hands(connection: socket.socket) -> None:
    """Open a connection as ZeroMQ does. Raises ConnectionError."""
    connection.sendall(GREETING + _command(b"\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB"))
    awaited = len(GREETING) + READY_BYTES
    while awaited:
        heard = connection.recv(awaited)
        if not heard:
            raise ConnectionError("it has hung up")
        awaited -= len(heard)


def queued_bytes(connection: socket.socket) -> int | None:
    """Return the bytes that queue in the kernel at this connection's other end, here; None when
    that end has let go of it.
    """
    ours = f"{connection.getsockname()[1]:04X}"
    for line in Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]:
        _, _, remote, state, queues, *_ = line.split()
        if remote.endswith(f":{ours}") and state == ESTABLISHED:
            return int(queues.partition(":")[0], 16)
    return None


def raw_garbage(port: int, count: int, rng: random.Random) -> None:
    """Connections that send random bytes and go."""
    for _ in range(count):
        # Whoever reads it may have hung up already, or take no connection for now.
        with (
            suppress(ConnectionError, TimeoutError),
            socket.create_connection(("127.0.0.1", port), PATIENCE_S) as connection,
        ):
            connection.sendall(rng.choice((b"", GREETING[:12], GREETING)))
            connection.sendall(rng.randbytes(RAW_BYTES))


def garbage_messages(port: int, kind: int, count: int, rng: random.Random) -> None:
    """Send random messages from a socket of a kind, over a valid ZeroMQ connection."""
    with zmq.Context() as context, context.socket(kind) as peer:
        peer.setsockopt(zmq.LINGER, 0)
        peer.setsockopt(zmq.SNDTIMEO, 1)
        peer.connect(f"tcp://127.0.0.1:{port}")
        for _ in range(count):
            try:
                peer.send(rng.randbytes(rng.choice(MESSAGE_BYTES)))
            except zmq.Again:
                continue


@contextmanager
def silent_connections(port: int, count: int) -> Iterator[None]:
    """Hold connections that send nothing, within a `with`; fewer where no more are taken."""
    with ExitStack() as held:
        with suppress(TimeoutError):
            for _ in range(count):
                held.enter_context(socket.create_connection(("127.0.0.1", port), TURNED_AWAY_S))
        yield


def _command(body: bytes) -> bytes:
    return struct.pack("BB", 4, len(body)) + body
