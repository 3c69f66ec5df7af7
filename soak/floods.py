"""Flood ports with garbage: `python -m soak.floods KIND SEED ADDRESS...`.

It runs until it, or its parent, ends. For "telemetry" the addresses are displays' telemetry, for
the other kinds a sensing node's ports.
"""

import itertools
import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from random import Random

import zmq

from protocol.sockets import control_address
from tests.support.hostile_peers import hold, send_bytes, send_messages

# The pause leaves the nodes processor time for their own work.
PAUSE_S = 0.002
ROUNDS = 20
MESSAGES = 1_000
HELD_CONNECTIONS = 300
send_rounds = partial(send_bytes, rounds=ROUNDS, pause_s=PAUSE_S)


def main(arguments: list[str]) -> None:
    """Flood while the parent runs."""
    parent = os.getppid()
    kind, seed, *addresses = arguments
    random = Random(int(seed))
    flood = FLOODS[kind]
    for address in itertools.cycle(addresses):
        if os.getppid() != parent:
            return
        with suppress(OSError, zmq.ZMQError):  # refused or closed: continue with the next address
            flood(address, random)
        time.sleep(PAUSE_S)


def send_to_both(address: str, random: Random) -> None:
    """Send messages to control, and subscriptions to data."""
    send_messages(control_address(address), zmq.DEALER, MESSAGES, random, PAUSE_S)
    with zmq.Context() as context, context.socket(zmq.SUB) as data:
        _subscribe_to_much(data, address, random)


def hold_connections(address: str, _: Random) -> None:
    """Hold many connections that send nothing."""
    with ExitStack() as held:
        hold(address, HELD_CONNECTIONS, held, PAUSE_S)


def read_nothing(address: str, random: Random) -> None:
    """Subscribe to telemetry and many other topics without reading, and send garbage as well."""
    with zmq.Context() as context, context.socket(zmq.SUB) as deaf:
        deaf.setsockopt(zmq.RCVHWM, 1)
        deaf.setsockopt(zmq.RCVBUF, 4096)
        deaf.subscribe(b"")
        _subscribe_to_much(deaf, address, random)
        with suppress(OSError):
            send_rounds(address, random)
        time.sleep(0.5)


def _subscribe_to_much(socket: "zmq.Socket[bytes]", address: str, random: Random) -> None:
    socket.setsockopt(zmq.LINGER, 0)
    socket.connect(address)
    for _ in range(MESSAGES):
        socket.subscribe(random.randbytes(random.randrange(1, 200)))


FLOODS: dict[str, Callable[[str, Random], None]] = {
    "bytes": send_rounds,
    "messages": send_to_both,
    "connections": hold_connections,
    "telemetry": read_nothing,
}


if __name__ == "__main__":
    main(sys.argv[1:])
