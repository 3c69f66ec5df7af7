"""Stand in for a sensing node at its address: `python -m soak.impostor ADDRESS SEED`.

It runs until it, or its parent, ends. It answers displays as a sensing node does, and streams
forces that no wrist has, with garbage between the frames. Its sample numbers are right, so that a
display's counts can be checked.
"""

import os
import sys
import time
from random import Random

import numpy as np
import zmq

from protocol import sockets
from protocol.tactile import ElasticLayer
from protocol.wire.messages import ClockReply, Frame, encode_control, encode_frame
from protocol.wire.stream import Channel, StreamDescription
from sensing_node.control_server import ControlServer

BATCH = 5
PERIOD_NS = 1_000_000
# The last two are the largest values that a display accepts as a force.
FORCES_N = (0.0, 0.3, 5.0, -1.0, 9e5, -9e5)


def main(arguments: list[str]) -> None:
    """Answer and stream while the parent runs."""
    parent = os.getppid()
    address, seed = arguments
    random = Random(int(seed))
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
    control = sockets.bind(context, zmq.ROUTER, sockets.control_address(address))
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


if __name__ == "__main__":
    main(sys.argv[1:])
