"""`python -m tests.support.altered_node ALTERATION MODULE ARGUMENTS`: a node with a fault in it.

`step=SECONDS`: its monotonic clock steps by so much at each SIGUSR1. To simulate a suspended host,
stop the process, and step its clock back by the time for which it was stopped. `flood=data` or
`flood=control`: a sensing node that sends each frame, or each control answer, hundreds of times.
"""

import runpy
import signal
import sys
import time

import zmq

STEP = signal.SIGUSR1
# Copies of each message: 75 000 frames a second.
COPIES = {"data": 375, "control": 1_500}


def make_clock_step(seconds: str) -> None:
    """Step the monotonic clock at each signal."""
    step_ns = round(float(seconds) * 1e9)
    steady_ns = time.perf_counter_ns
    steps = 0

    def step(*_: object) -> None:
        nonlocal steps
        steps += 1

    signal.signal(STEP, step)
    time.perf_counter_ns = lambda: steady_ns() + steps * step_ns


def send_copies(port: str) -> None:
    """Send every message of a port many times, past the send queue's own limit."""
    from protocol import sockets
    from sensing_node import node

    send = sockets.send

    def send_many(socket: sockets.Socket, *parts: bytes) -> bool:
        flooded = (socket.socket_type == zmq.XPUB) == (port == "data")
        sent = [send(socket, *parts) for _ in range(COPIES[port] if flooded else 1)]
        return any(sent)

    sockets.send = send_many
    limits = node.queue_limits
    node.queue_limits = lambda description: {**limits(description), zmq.SNDHWM: 100_000}


if __name__ == "__main__":
    alteration, _, value = sys.argv[1].partition("=")
    {"step": make_clock_step, "flood": send_copies}[alteration](value)
    del sys.argv[:2]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
