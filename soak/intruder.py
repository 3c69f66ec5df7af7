"""Attack nodes: `python -m soak.intruder KIND SEED ADDRESS...`, until it, or its parent, ends.

An "impostor" stands in for a sensing node at its address: it answers displays as a sensing node
does, and streams forces that no wrist has, with garbage between the frames. Its sample numbers are
right, so that a display's counts can be checked. The other kinds flood ports with garbage: with
"telemetry" those of displays' telemetry, else a sensing node's.
"""

import itertools
import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from random import Random

import numpy as np
import zmq

from protocol import sockets
from protocol.sockets import control_address
from protocol.tactile import ElasticLayer
from protocol.wire.description import Channel, StreamDescription
from protocol.wire.messages import ClockReply, Frame, encode_control, encode_frame
from sensing_node.control_server import ControlServer
from tests.support.hostile_peers import hold, send_bytes, send_messages

# The pause leaves the nodes processor time for their own work.
PAUSE_S = 0.002
ROUNDS = 20
MESSAGES = 1_000
HELD_CONNECTIONS = 300
BATCH = 5
PERIOD_NS = 1_000_000
# The last two are the largest values that a display accepts as a force.
FORCES_N = (0.0, 0.3, 5.0, -1.0, 9e5, -9e5)
send_rounds = partial(send_bytes, rounds=ROUNDS, pause_s=PAUSE_S)


def main(arguments: list[str]) -> None:
    """Attack while the parent runs."""
    parent = os.getppid()
    kind, seed, *addresses = arguments
    random = Random(int(seed))
    if kind == "impostor":
        impersonate(addresses[0], random, parent)
        return
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


def impersonate(address: str, random: Random, parent: int) -> None:
    """Answer and stream as a sensing node while the parent runs."""
    session = random.getrandbits(62)
    description = StreamDescription(
        name="not a wrist",
        period_ns=PERIOD_NS,
        batch=BATCH,
        channels=(Channel("pulse"),),
        layer=ElasticLayer(),
    )
    server = ControlServer(description, session)
    context: sockets.Context = zmq.Context()
    control = sockets.bind(context, zmq.ROUTER, control_address(address))
    data = sockets.bind(context, zmq.PUB, address)
    first, due_ns = 0, time.perf_counter_ns()
    while os.getppid() == parent:
        for *envelope, message in sockets.receive_multipart(control):
            now_ns = time.perf_counter_ns()
            reply = server.answer(tuple(envelope), message, now_ns, first)
            if reply is not None:
                sockets.send(control, *envelope, encode_control(reply))
            # A further reply was not requested.
            false_ns = random.getrandbits(61), random.getrandbits(61)
            unrequested = encode_control(ClockReply(session, now_ns, *false_ns))
            sockets.send(control, *envelope, unrequested)
        if time.perf_counter_ns() < due_ns:
            sockets.wait_readable([control], due_ns - time.perf_counter_ns())
            continue
        forces_n = [[random.choice(FORCES_N)] for _ in range(BATCH)]
        values = np.array(forces_n, "<f4")
        t_first_ns = due_ns - (BATCH - 1) * PERIOD_NS
        frame = encode_frame(Frame(session, first, t_first_ns, PERIOD_NS, values))
        sockets.send(data, frame)
        sockets.send(data, frame[: random.randrange(len(frame))])
        sockets.send(data, random.randbytes(random.randrange(1, 100_000)))
        first += BATCH
        due_ns += BATCH * PERIOD_NS


FLOODS: dict[str, Callable[[str, Random], None]] = {
    "bytes": send_rounds,
    "messages": send_to_both,
    "connections": hold_connections,
    "telemetry": read_nothing,
}


if __name__ == "__main__":
    main(sys.argv[1:])
