"""Connection events of a ZeroMQ socket, and failed connections to another node."""

import itertools
import logging
import struct
from collections import Counter
from collections.abc import Iterator

import zmq

from protocol.refusals import (
    CONNECTIONS,
    HANDSHAKE,
    NO_KEY,
    NOT_AUTHENTIC,
    REFUSED_KEY,
    REPLAYED,
    REVOKED,
)
from protocol.security.link_keys import ClientKeys
from protocol.sockets import Context, Socket, receive_multipart

logger = logging.getLogger(__name__)

FAILURES = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
_CAUSES: dict[int, str] = {
    zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH: NO_KEY,
    zmq.PROTOCOL_ERROR_ZMTP_CRYPTOGRAPHIC: NOT_AUTHENTIC,
    zmq.PROTOCOL_ERROR_ZMTP_INVALID_SEQUENCE: REPLAYED,
}
# Event and value. `zmq.utils.monitor` turns both into enumerations, even a descriptor, which takes
# 40 µs for a new value (docs/decisions/0031-zmq-auth-is-not-enough.md).
_EVENT = struct.Struct("=HI")
MAX_EVENTS = 200
_numbers = itertools.count()
POLL_EVERY_NS = 10_000_000
# Number of broken handshakes that is reported; a node that shuts down breaks one or two.
REPEATED_BREAKS = 3
_HANDSHAKE_EVENTS = (
    zmq.EVENT_CONNECTED
    | zmq.EVENT_CONNECT_RETRIED
    | zmq.EVENT_HANDSHAKE_SUCCEEDED
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
    | zmq.EVENT_DISCONNECTED
    | FAILURES
)


class SocketMonitor:
    """Monitor of chosen events on one socket; create it before the socket binds or connects.

    socket: readable when events wait.
    """

    def __init__(self, context: Context, watched: Socket, events: int) -> None:
        endpoint = f"inproc://monitor-{next(_numbers)}"
        watched.monitor(endpoint, events)
        self.socket = context.socket(zmq.PAIR)
        self.socket.setsockopt(zmq.LINGER, 0)
        # No high-water mark: at one, ZeroMQ's thread would wait for a reader, and block all
        # connections. `Socket.get_monitor_socket` leaves the default of 1000.
        self.socket.setsockopt(zmq.RCVHWM, 0)
        self.socket.connect(endpoint)

    def events(self, most: int = MAX_EVENTS) -> Iterator[tuple[int, int, str]]:
        """Yield event, value and endpoint of up to `most` waiting events.

        The bound ensures that a peer that connects repeatedly cannot hold a loop here.
        """
        for head, endpoint in receive_multipart(self.socket, most):
            event, value = _EVENT.unpack(head)
            yield event, value, endpoint.decode("utf-8", "replace")


def cause_of(value: int) -> str:
    """Return the cause of an event in `FAILURES`, from its value.

    ZeroMQ also reports a message that it cannot decrypt as a failed handshake.
    """
    return _CAUSES.get(value, HANDSHAKE)


class HandshakeMonitor:
    """Monitor of connecting sockets: counts failed handshakes and reports each reason once.

    ZeroMQ itself retries without end and reports nothing. rejected: failed handshakes by cause.
    connected: sockets whose TCP connection is open; its handshake may still fail. established:
    those whose handshake has succeeded. retried: attempts to connect that failed, by socket.
    refusal: the last failed handshake, with what to do about it; empty after one that succeeded.
    """

    def __init__(self, context: Context, keys: ClientKeys | None) -> None:
        self._context = context
        self._keys = keys
        self._monitors: list[tuple[Socket, SocketMonitor]] = []
        self._breaks: Counter[str] = Counter()
        # Hosts that have allowed this node's key; a later refusal is a revocation.
        self._allowed_by: set[str] = set()
        self._reported: set[tuple[str, str]] = set()
        self._poll_ns = 0
        self.rejected: Counter[str] = Counter()
        self.connected: set[Socket] = set()
        self.established: set[Socket] = set()
        self.retried: Counter[Socket] = Counter()
        self.refusal = ""

    def watch(self, socket: Socket) -> None:
        """Monitor a socket; call this before it connects."""
        self._monitors.append((socket, SocketMonitor(self._context, socket, _HANDSHAKE_EVENTS)))

    def poll(self, now_ns: int) -> list[Socket]:
        """Read the waiting events; call it often.

        Returns the sockets whose TCP connection was opened since the last call.
        """
        if now_ns < self._poll_ns:
            return []
        self._poll_ns = now_ns + POLL_EVERY_NS
        answered = []
        for socket, monitor in self._monitors:
            for event, value, endpoint in monitor.events():
                if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                    self.established.add(socket)
                else:
                    self.established.discard(socket)
                if event == zmq.EVENT_CONNECTED:
                    self.connected.add(socket)
                    answered.append(socket)
                elif event == zmq.EVENT_CONNECT_RETRIED:
                    self.connected.discard(socket)
                    self.retried[socket] += 1
                elif event == zmq.EVENT_DISCONNECTED:
                    self.connected.discard(socket)
                else:
                    self._count(event, value, endpoint)
        return answered

    def _count(self, event: int, value: int, endpoint: str) -> None:
        # Without the port, since data and control of a node fail for the same reason.
        host = endpoint.rpartition(":")[0]
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._breaks[host], self.refusal = 0, ""
            self._allowed_by.add(host)
            # A second revocation is reported again.
            self._reported.discard((REVOKED, host))
            return
        if event != zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            cause = cause_of(value)
        else:
            cause = REVOKED if host in self._allowed_by else REFUSED_KEY
        self.rejected[cause] += 1
        if cause == HANDSHAKE:
            self._breaks[host] += 1
            if self._breaks[host] < REPEATED_BREAKS:
                return
        words, keys = CONNECTIONS[cause], self._keys
        reason = words.without_keys
        if keys is not None:
            reason = words.at_client.format(own=keys.own.name, peer=keys.peer.name)
        self.refusal = f"{endpoint} {reason}"
        if (cause, host) not in self._reported:
            self._reported.add((cause, host))
            logger.warning(self.refusal)
