"""A display that runs as a process: its arguments and its telemetry."""

import time
from collections.abc import Callable

import zmq

from protocol.sockets import Context, Socket
from protocol.wire.telemetry import STATUS, Status, read_status
from tests.support.nodes import RADIAL

MODULE = "display_node.cli"
PATIENCE_S = 20.0


def subscribe(context: Context, address: str) -> Socket:
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVTIMEO, 200)
    socket.subscribe(b"")
    socket.connect(address)
    return socket


def await_state(telemetry: Socket, state: str) -> Status:
    """Return the first status in a state. Raises TimeoutError."""
    return await_status(telemetry, lambda status: status.state == state)


def await_status(
    telemetry: Socket, wanted: Callable[[Status], bool], within_s: float = PATIENCE_S
) -> Status:
    """Return the first status that is as wanted. Raises TimeoutError."""
    end_s = time.monotonic() + within_s
    while time.monotonic() < end_s:
        try:
            topic, data = telemetry.recv_multipart()
        except zmq.Again:
            continue
        if topic == STATUS and wanted(status := read_status(data)):
            return status
    raise TimeoutError(f"no status of the display was as wanted within {within_s:g} s")


def display_arguments(address: str, telemetry: str, *more: str) -> tuple[str, ...]:
    return (
        *(str(RADIAL), "--connect", address, "--telemetry", telemetry),
        *("--no-screen", "--seconds", "60", *more),
    )


def sensing_arguments(address: str, seconds: float) -> tuple[str, ...]:
    return (str(RADIAL), "--bind", address, "--seconds", str(seconds), "--quiet")
