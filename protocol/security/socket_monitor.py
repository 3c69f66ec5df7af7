"""Events of a socket's connections, as ZeroMQ's monitor reports them."""

import itertools
import struct
from collections.abc import Iterator

import zmq

from protocol.sockets import Context, Socket, receive_all

NO_KEY, NOT_AUTHENTIC, REPLAYED, HANDSHAKE = "no_key", "not_authentic", "replayed", "handshake"
_CAUSES: dict[int, str] = {
    zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH: NO_KEY,
    zmq.PROTOCOL_ERROR_ZMTP_CRYPTOGRAPHIC: NOT_AUTHENTIC,
    zmq.PROTOCOL_ERROR_ZMTP_INVALID_SEQUENCE: REPLAYED,
}
FAILURES = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
_EVENT = struct.Struct("=HI")
MAX_EVENTS = 200
_numbers = itertools.count()


class SocketMonitor:
    """Hears of chosen events on one socket, from before it binds or connects.

    socket: to wait for.
    """

    def __init__(self, context: Context, watched: Socket, events: int) -> None:
        endpoint = f"inproc://watch-{next(_numbers)}"
        watched.monitor(endpoint, events)
        self.socket = context.socket(zmq.PAIR)
        self.socket.setsockopt(zmq.LINGER, 0)
        # ZeroMQ's thread waits for a reader at its high-water mark, and with it every connection.
        self.socket.setsockopt(zmq.RCVHWM, 0)
        self.socket.connect(endpoint)

    def events(self, most: int = MAX_EVENTS) -> Iterator[tuple[int, int, str]]:
        """Yield event, its value and the address it happened at, for `most` of those that wait.

        Bounded, as whoever connects as fast as he can would keep a loop here for good.
        """
        for head, endpoint in receive_all(self.socket, most):
            event, value = _EVENT.unpack(head)
            yield event, value, endpoint.decode("utf-8", "replace")


def cause_of(value: int) -> str:
    """The cause that one of `FAILURES` is counted under, by its value.

    ZeroMQ tells of a message that cannot be opened as of a handshake that fails.
    """
    return _CAUSES.get(value, HANDSHAKE)
