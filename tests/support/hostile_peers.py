"""Hostile peers: they never read, send garbage, send nothing, or flood a node with requests."""

import random
import socket
import struct
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import msgpack
import zmq

from protocol.sockets import control_address
from protocol.wire.messages import ClockRequest, encode_control

PATIENCE_S = 10.0
# A node that accepts no connections for now drops connection requests, which TCP repeats after 1 s.
REFUSED_WITHIN_S = 2.0
# ZMTP 3.0 without a mechanism, see rfc.zeromq.org/spec/23.
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)
READY = b"\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB"
READY_BYTES = 27
SUBSCRIBE_TO_ALL = b"\x00\x01\x01"
MESSAGE_BYTES = (0, 1, 10, 100, 10_000, 60_000)
RAW_BYTES = 2_000
ESTABLISHED = "01"
BURST = 200
PAUSED_EVERY = 20
# Of control messages, and one that is none.
KINDS = ("hello", "clock?", "report", "bye", "welcome", "x" * 50)


def port_of(address: str) -> int:
    """Return the port of a TCP address."""
    return int(address.rpartition(":")[2])


def deaf_subscriber(port: int) -> socket.socket:
    """Subscribe to everything a PUB socket on this machine sends, and never read.

    It does not use ZeroMQ, whose thread would read. It has the kernel's smallest buffer.
    """
    connection = socket.socket()
    connection.settimeout(PATIENCE_S)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    connection.connect(("127.0.0.1", port))
    _shake_hands(connection)
    connection.sendall(SUBSCRIBE_TO_ALL)
    return connection


def subscribe_endlessly(port: int, topic_bytes: int, seconds: float) -> None:
    """Subscribe to new topics as fast as possible, and reconnect when cut off."""
    end_s, number = time.monotonic() + seconds, 0
    while time.monotonic() < end_s:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), seconds) as peer:
            _shake_hands(peer)
            while time.monotonic() < end_s:
                topics = (b"%0*d" % (topic_bytes, n) for n in range(number, number + BURST))
                peer.sendall(
                    b"".join(b"\2" + struct.pack(">Q", len(t) + 1) + b"\1" + t for t in topics)
                )
                number += BURST


def connected(address: str, within_s: float = PATIENCE_S) -> socket.socket:
    """Connect to a TCP or ipc address without ZeroMQ."""
    scheme, _, place = address.partition("://")
    if scheme == "ipc":
        plain = socket.socket(socket.AF_UNIX)
        plain.settimeout(within_s)
        plain.connect(place)
        return plain
    host, _, port = place.rpartition(":")
    return socket.create_connection((host, int(port)), within_s)


def _shake_hands(connection: socket.socket) -> None:
    """Open a connection as ZeroMQ does."""
    connection.sendall(GREETING + struct.pack("BB", 4, len(READY)) + READY)
    awaited = len(GREETING) + READY_BYTES
    while awaited:
        received = connection.recv(awaited)
        if not received:
            raise ConnectionError("closed by the peer")
        awaited -= len(received)


def queued_bytes(connection: socket.socket) -> int | None:
    """Return the bytes queued in the kernel at the far end of a local connection.

    None if that end has closed it.
    """
    ours = f"{connection.getsockname()[1]:04X}"
    for line in Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]:
        _, _, remote, state, queues, *_ = line.split()
        if remote.endswith(f":{ours}") and state == ESTABLISHED:
            return int(queues.partition(":")[0], 16)
    return None


def send_garbage(
    port: int, connections: int, messages: int, silent: int, rng: random.Random
) -> None:
    """Send random bytes and random messages to a port while it holds silent connections."""
    address = f"tcp://127.0.0.1:{port}"
    with ExitStack() as held:
        hold(address, silent, held)
        for _ in range(connections):
            # The receiver may have closed it already, or accept no connection for now.
            with suppress(ConnectionError, TimeoutError):
                send_bytes(address, rng)
        for kind in (zmq.DEALER, zmq.XSUB, zmq.PUB):
            send_messages(address, kind, messages, rng)


def hold(address: str, count: int, held: ExitStack, pause_s: float = 0.0) -> None:
    """Open connections that send nothing; fewer where the address accepts no more."""
    with suppress(TimeoutError):
        for _ in range(count):
            held.enter_context(connected(address, REFUSED_WITHIN_S))
            time.sleep(pause_s)


def send_bytes(address: str, rng: random.Random, rounds: int = 1, pause_s: float = 0.0) -> None:
    """Send bytes that are not ZMTP, or only begin like it."""
    with connected(address) as peer:
        peer.sendall(rng.choice((b"", GREETING[:12], GREETING, b"GET / HTTP/1.1\r\n\r\n")))
        for _ in range(rounds):
            peer.sendall(rng.randbytes(RAW_BYTES))
            time.sleep(pause_s)


def send_messages(
    address: str, kind: int, count: int, rng: random.Random, pause_s: float = 0.0
) -> None:
    """Send garbage in valid ZMTP."""
    with zmq.Context() as context, context.socket(kind) as peer:
        peer.setsockopt(zmq.LINGER, 0)
        peer.setsockopt(zmq.SNDTIMEO, 1)
        peer.connect(address)
        for number in range(count):
            with suppress(zmq.Again):
                peer.send_multipart(garbage(rng))
            if number % PAUSED_EVERY == 0:
                time.sleep(pause_s)


def garbage(rng: random.Random) -> list[bytes]:
    """Return the parts of a message: random bytes, or msgpack that resembles a message."""
    size = rng.choice(MESSAGE_BYTES)
    named = [2, rng.choice(KINDS), *(rng.getrandbits(63) for _ in range(size % 9))]
    part = rng.randbytes(size) if rng.random() < 0.5 else bytes(msgpack.packb(named))
    return [part] * rng.choice((1, 1, 1, 6))


def flood_with_requests(address: str, seconds: float) -> int:
    """Send clock requests to a sensing node as fast as possible; return how many."""
    count, end_s = 0, time.monotonic() + seconds
    with zmq.Context() as context, context.socket(zmq.DEALER) as peer:
        peer.setsockopt(zmq.LINGER, 0)
        peer.connect(control_address(address))
        while time.monotonic() < end_s:
            for _ in range(100):
                try:
                    peer.send(encode_control(ClockRequest(time.perf_counter_ns())), zmq.NOBLOCK)
                    count += 1
                except zmq.Again:
                    time.sleep(0.0005)
            while peer.poll(0):
                peer.recv_multipart()
    return count
