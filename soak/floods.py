"""Flood ports with garbage: `python -m soak.floods KIND SEED ADDRESS...`.

It runs until it, or its parent, ends. For "telemetry" the addresses are displays' telemetry, for
the other kinds a sensing node's ports.
"""

import itertools
import os
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from random import Random

import msgpack
import zmq

from protocol import sockets

# The pause leaves the nodes processor time for their own work.
PAUSE_S = 0.002
ROUND = 20
MAX_BYTES = 2_000
HELD_CONNECTIONS = 300


def main(arguments: list[str]) -> None:
    """Flood while the parent runs."""
    parent = os.getppid()
    kind, seed, *addresses = arguments
    random = Random(int(seed))
    flood: Callable[[str, Random], None] = {
        "bytes": send_bytes,
        "messages": send_messages,
        "connections": hold_connections,
        "telemetry": read_nothing,
    }[kind]
    for address in itertools.cycle(addresses):
        if os.getppid() != parent:
            return
        with suppress(OSError, zmq.ZMQError):  # refused or closed: continue with the next address
            flood(address, random)
        time.sleep(PAUSE_S)


def send_bytes(address: str, random: Random) -> None:
    """Send bytes that are not ZMTP, or only begin like it."""
    with _connected(address) as plain:
        greeting = b"\xff" + bytes(8) + b"\x7f\x03" + random.randbytes(53)
        plain.sendall(random.choice((b"", greeting, b"GET / HTTP/1.1\r\n\r\n")))
        for _ in range(ROUND):
            plain.sendall(random.randbytes(random.randrange(1, MAX_BYTES)))
            time.sleep(PAUSE_S)


def send_messages(address: str, random: Random) -> None:
    """Send garbage in valid ZMTP: messages to control, subscriptions to data."""
    with (
        zmq.Context() as context,
        context.socket(zmq.DEALER) as control,
        context.socket(zmq.SUB) as data,
    ):
        for plain in (control, data):
            plain.setsockopt(zmq.LINGER, 0)
        data.connect(address)
        control.connect(sockets.control_address(address))
        for _ in range(50 * ROUND):
            with suppress(zmq.Again):
                control.send_multipart(_garbage(random), zmq.NOBLOCK)
            data.subscribe(random.randbytes(random.randrange(1, 200)))
            if random.random() < 1 / ROUND:
                time.sleep(PAUSE_S)


def hold_connections(address: str, random: Random) -> None:
    """Hold many connections that send nothing."""
    held: list[socket.socket] = []
    try:
        for _ in range(HELD_CONNECTIONS):
            held.append(_connected(address))
            time.sleep(PAUSE_S)
    finally:
        for plain in held:
            plain.close()


def read_nothing(address: str, random: Random) -> None:
    """Subscribe to telemetry and many other topics without reading, and send garbage as well."""
    with zmq.Context() as context, context.socket(zmq.SUB) as deaf:
        deaf.setsockopt(zmq.RCVHWM, 1)
        deaf.setsockopt(zmq.RCVBUF, 4096)
        deaf.connect(address)
        deaf.subscribe(b"")
        for _ in range(50 * ROUND):
            deaf.subscribe(random.randbytes(random.randrange(1, 200)))
        with suppress(OSError):
            send_bytes(address, random)
        time.sleep(0.5)


def _garbage(random: Random) -> list[bytes]:
    """Return random bytes, or msgpack that resembles a message."""
    size = random.choice((0, 1, 10, 100, MAX_BYTES))
    body = random.randbytes(size)
    kinds = ("hello", "clock?", "report", "bye", "welcome", "x" * 50)
    mapped = [1, random.choice(kinds), *(random.getrandbits(63) for _ in range(size % 9))]
    parts = [body if random.random() < 0.5 else bytes(msgpack.packb(mapped))]
    return parts * random.choice((1, 1, 1, 6))


def _connected(address: str) -> socket.socket:
    scheme, _, place = address.partition("://")
    if scheme == "ipc":
        plain = socket.socket(socket.AF_UNIX)
        plain.connect(place)
    else:
        host, _, port = place.rpartition(":")
        plain = socket.create_connection((host, int(port)), timeout=1.0)
    plain.settimeout(1.0)
    return plain


if __name__ == "__main__":
    main(sys.argv[1:])
