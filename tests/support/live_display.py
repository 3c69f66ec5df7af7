"""A display that runs as a process: how it is started, what it tells of itself."""

import time
from collections.abc import Callable

import pytest
import zmq

from protocol.sockets import Context
from protocol.wire.telemetry import STATUS, Status, read_status
from tests.support.nodes import RADIAL

MODULE = "display_node.cli"
PATIENCE_S = 20.0


def subscribe(context: Context, address: str) -> zmq.Socket:
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVTIMEO, 200)
    socket.subscribe(b"")
    socket.connect(address)
    return socket


def await_state(telemetry: zmq.Socket, state: str) -> Status:
    """The first status in a state, within patience."""
    return await_status(telemetry, lambda status: status.state == state)


def await_status(telemetry: zmq.Socket, wanted: Callable[[Status], bool]) -> Status:
    """The first status that is as wanted, within patience."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        try:
            topic, data = telemetry.recv_multipart()
        except zmq.Again:
            continue
        if topic == STATUS and wanted(status := read_status(data)):
            return status
    pytest.fail(f"the display was not as wanted within {PATIENCE_S} s")


def display_arguments(address: str, telemetry: str, *more: str) -> tuple[str, ...]:
    return (
        *(str(RADIAL), "--connect", address, "--telemetry", telemetry),
        *("--no-screen", "--seconds", "60", *more),
    )


def sensing_arguments(address: str, seconds: float) -> tuple[str, ...]:
    return (str(RADIAL), "--bind", address, "--seconds", str(seconds), "--quiet")
