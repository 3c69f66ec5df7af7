"""CURVE on ZeroMQ's sockets: set before they bind or connect."""

import zmq

from benchmarks.peers.message import Keys
from protocol.sockets import Socket


def make_keys() -> Keys:
    """Return keys for a server and its one client."""
    return Keys(*zmq.curve_keypair(), *zmq.curve_keypair())


def serve(socket: Socket, keys: Keys | None) -> Socket:
    """Make the socket encrypt as the server; without keys leave it as it is."""
    if keys is not None:
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, keys.server_secret)
    return socket


def join(socket: Socket, keys: Keys | None) -> Socket:
    """Make the socket encrypt as the client; without keys leave it as it is."""
    if keys is not None:
        socket.setsockopt(zmq.CURVE_SERVERKEY, keys.server_public)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, keys.client_public)
        socket.setsockopt(zmq.CURVE_SECRETKEY, keys.client_secret)
    return socket
