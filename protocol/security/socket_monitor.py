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
    OWN_KEY_REVOKED,
    OWN_KEY_UNKNOWN,
    REPLAYED,
    SERVER_LIST_UNREADABLE,
)
from protocol.security import zap
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
# Handshakes of a socket that break in a row before this counts as a refusal: a node that shuts down
# breaks one or two.
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
    """Monitor of a client's sockets: counts failed handshakes and reports each reason once.

    ZeroMQ itself retries without end and reports nothing. rejected: failed handshakes by cause;
    those that break by chance, fewer than `REPEATED_BREAKS` in a row, are left out. connected:
    sockets whose TCP connection is open; its handshake may still fail. established: those whose
    handshake has succeeded. retried: attempts to connect that failed, by socket. refused: cause of
    the last refusal, None after a handshake that succeeded; refusal: its text, with what to do
    about it.
    """

    def __init__(self, context: Context, keys: ClientKeys | None) -> None:
        self._context = context
        self._keys = keys
        self._monitors: list[tuple[Socket, SocketMonitor]] = []
        # Broken handshakes of each socket since its last one that did not break.
        self._breaks: Counter[Socket] = Counter()
        # Hosts that have accepted this node's key; a later refusal is a revocation.
        self._accepted_by: set[str] = set()
        self._reported: set[tuple[str, str]] = set()
        self._poll_ns = 0
        self.rejected: Counter[str] = Counter()
        self.connected: set[Socket] = set()
        self.established: set[Socket] = set()
        self.retried: Counter[Socket] = Counter()
        self.refused: str | None = None
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
                self.established.discard(socket)
                if event == zmq.EVENT_CONNECTED:
                    self.connected.add(socket)
                    answered.append(socket)
                elif event == zmq.EVENT_CONNECT_RETRIED:
                    self.connected.discard(socket)
                    self.retried[socket] += 1
                elif event == zmq.EVENT_DISCONNECTED:
                    self.connected.discard(socket)
                elif event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                    self.established.add(socket)
                    self._accept(socket, endpoint)
                else:
                    self._refuse(socket, event, value, endpoint)
        return answered

    def _accept(self, socket: Socket, endpoint: str) -> None:
        host = _host_of(endpoint)
        self._breaks[socket], self.refused, self.refusal = 0, None, ""
        self._accepted_by.add(host)
        # What can happen to a working link at any time is reported again.
        self._reported -= {(OWN_KEY_REVOKED, host), (SERVER_LIST_UNREADABLE, host)}

    def _refuse(self, socket: Socket, event: int, value: int, endpoint: str) -> None:
        host = _host_of(endpoint)
        cause = self._cause_of_refusal(event, value, host)
        if cause == HANDSHAKE:
            self._breaks[socket] += 1
            if self._breaks[socket] < REPEATED_BREAKS:
                return
            if self._breaks[socket] == REPEATED_BREAKS:
                self.rejected[cause] += REPEATED_BREAKS - 1
        self.rejected[cause] += 1
        words, keys = CONNECTIONS[cause], self._keys
        reason = words.without_keys
        if keys is not None:
            reason = words.at_client.format(client=keys.pair.name, server=keys.server_key.name)
        self.refused, self.refusal = cause, f"{endpoint} {reason}"
        if (cause, host) not in self._reported:
            self._reported.add((cause, host))
            logger.warning(self.refusal)

    def _cause_of_refusal(self, event: int, value: int, host: str) -> str:
        if event != zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            return cause_of(value)
        if value == zap.CANNOT_DECIDE:
            return SERVER_LIST_UNREADABLE
        return OWN_KEY_REVOKED if host in self._accepted_by else OWN_KEY_UNKNOWN


def _host_of(endpoint: str) -> str:
    """Return an endpoint without its port: a node's data and control fail for the same reason."""
    return endpoint.rpartition(":")[0]
