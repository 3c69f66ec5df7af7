"""Interface of every peer's publisher and subscriber, and CURVE on ZeroMQ's sockets."""

import struct
from typing import NamedTuple

import zmq

from protocol.sockets import Socket
from tests.support.keyring import Keyring

VALUE = 0.5
FIELDS = struct.Struct("<qqf")
"""Number, time in ns and one sample, for peers without a format of their own."""


class Wire(NamedTuple):
    """The address of both processes: a port of 127.0.0.1 and the next one; keys if encrypted."""

    port: int
    keys: Keyring | None


class Arrival(NamedTuple):
    """A message: its number, the time before encoding, the time when its value could be used.

    Both times are of CLOCK_MONOTONIC, which processes of one machine share.
    """

    sequence: int
    sent_ns: int
    usable_ns: int


def serve(socket: Socket, keys: Keyring | None) -> Socket:
    """Make the socket encrypt as the server; without keys leave it as it is."""
    if keys is not None:
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, keys.pair("wrist").secret)
    return socket


def join(socket: Socket, keys: Keyring | None) -> Socket:
    """Make the socket encrypt as the client; without keys leave it as it is."""
    if keys is not None:
        keys.client("finger").protect(socket)
    return socket
