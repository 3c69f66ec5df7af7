"""CURVE on ZeroMQ's sockets: set before they bind or connect."""

import zmq

from benchmarks.peers.message import Keys
from protocol.sockets import Socket


def make_keys() -> Keys:
    """Keys for a server and the one client that it knows."""
    return Keys(*zmq.curve_keypair(), *zmq.curve_keypair())


def serve(socket: Socket, keys: Keys | None) -> Socket:
    """The socket, encrypting as the server; as it is without keys."""
    if keys is not None:
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, keys.server_secret)
    return socket


def join(socket: Socket, keys: Keys | None) -> Socket:
    """The socket, encrypting as the client; as it is without keys."""
    if keys is not None:
        socket.setsockopt(zmq.CURVE_SERVERKEY, keys.server_public)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, keys.client_public)
        socket.setsockopt(zmq.CURVE_SECRETKEY, keys.client_secret)
    return socket
