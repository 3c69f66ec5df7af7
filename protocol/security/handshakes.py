"""Handshakes of ZeroMQ connections: the events of a socket, and the refusals of a client."""

import itertools
import logging
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import zmq

from protocol.refusals import (
    CONNECTIONS,
    HANDSHAKE,
    NO_KEY,
    NOT_AUTHENTIC,
    REFUSED_KEY,
    REPLAYED,
    REVOKED,
    SERVER_LIST_UNREADABLE,
    Reason,
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
    | zmq.EVENT_CLOSED
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


class Refusal(NamedTuple):
    """Refusal of a client's connection.

    cause: of `CONNECTIONS`. address: of the server, as the user gave it. endpoint: the IP address
    and port that were connected. reason: the address, the reason, and what to do about it.
    """

    cause: str
    address: str
    endpoint: str
    reason: Reason


@dataclass(eq=False)
class ClientLink:
    """Sockets that connect to one port of a server, and the present refusal of them.

    address: returns the server's address as the user gave it. refusal: the last one; None once a
    handshake has succeeded, or where it came from accepts no connection any more.
    """

    address: Callable[[], str]
    refusal: Refusal | None = None


class HandshakeMonitor:
    """Monitor of a client's sockets: counts failed handshakes and reports each reason once.

    ZeroMQ repeats a connection that breaks, without end, but not one that the server refused. So
    the callers connect again: `Connection.poll` of a display, `TelemetryClient.poll`, and `Relay`.

    rejected: failed handshakes by cause; those that break by chance, fewer than `REPEATED_BREAKS`
    in a row, are left out. connected: sockets whose TCP connection is open; its handshake may still
    fail. established: those whose handshake has succeeded. retried: attempts to connect that
    failed, by socket.
    """

    def __init__(self, context: Context, keys: ClientKeys | None) -> None:
        self._context = context
        self._keys = keys
        self._monitors: list[tuple[ClientLink, Socket, SocketMonitor]] = []
        # Broken handshakes of each socket since its last one that did not break.
        self._breaks: Counter[Socket] = Counter()
        # Addresses whose server has accepted this node's key; a later refusal is a revocation. Of
        # the server's answer a client receives the status alone (`zap`), which is the same for an
        # unknown and for a revoked key. The server decides that from its own memory, which ends
        # with its process: after its restart the two may differ.
        self._accepted_by: set[str] = set()
        self._reported: set[tuple[str, str]] = set()
        self._poll_ns = 0
        self.rejected: Counter[str] = Counter()
        self.connected: set[Socket] = set()
        self.established: set[Socket] = set()
        self.retried: Counter[Socket] = Counter()

    def watch(self, sockets: Sequence[Socket], address: Callable[[], str]) -> ClientLink:
        """Monitor the sockets of one link; call this before they connect.

        address: returns the server's address as the user gave it, at the time of a refusal.
        """
        link = ClientLink(address)
        for socket in sockets:
            monitor = SocketMonitor(self._context, socket, _HANDSHAKE_EVENTS)
            self._monitors.append((link, socket, monitor))
        return link

    def poll(self, now_ns: int) -> list[Socket]:
        """Read the waiting events; call it often.

        Returns the sockets whose TCP connection was opened since the last call.
        """
        if now_ns < self._poll_ns:
            return []
        self._poll_ns = now_ns + POLL_EVERY_NS
        answered = []
        for link, socket, monitor in self._monitors:
            for event, value, endpoint in monitor.events():
                if event == zmq.EVENT_CLOSED:
                    # An attempt has ended without a TCP connection. The attempt may be older than
                    # the socket's present connection, so only the refusal ends. Of a name with
                    # several IP addresses, one may refuse the key and another not be reached.
                    if link.refusal is not None and link.refusal.endpoint == endpoint:
                        link.refusal = None
                    continue
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
                    self._accept(link, socket)
                else:
                    self._refuse(link, socket, event, value, endpoint)
        return answered

    def _accept(self, link: ClientLink, socket: Socket) -> None:
        address = link.address()
        self._breaks[socket], link.refusal = 0, None
        self._accepted_by.add(address)
        # What can happen to a working link at any time is reported again.
        self._reported -= {(REVOKED, address), (SERVER_LIST_UNREADABLE, address)}

    def _refuse(
        self, link: ClientLink, socket: Socket, event: int, value: int, endpoint: str
    ) -> None:
        address = link.address()
        cause = self._cause_of_refusal(event, value, address)
        if cause != HANDSHAKE:
            self._breaks[socket] = 0
        else:
            self._breaks[socket] += 1
            if self._breaks[socket] < REPEATED_BREAKS:
                return
            if self._breaks[socket] == REPEATED_BREAKS:
                self.rejected[cause] += REPEATED_BREAKS - 1
        self.rejected[cause] += 1
        link.refusal = Refusal(cause, address, endpoint, self._reason(address, cause))
        # Data and control of a node fail for the same reason.
        if (cause, address) not in self._reported:
            self._reported.add((cause, address))
            logger.warning(str(link.refusal.reason))

    def _cause_of_refusal(self, event: int, value: int, address: str) -> str:
        if event != zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            return cause_of(value)
        if value == zap.CANNOT_DECIDE:
            return SERVER_LIST_UNREADABLE
        return REVOKED if address in self._accepted_by else REFUSED_KEY

    def _reason(self, address: str, cause: str) -> Reason:
        words, keys = CONNECTIONS[cause], self._keys
        if keys is None:
            text, further = words.without_keys.text, words.without_keys.further
        else:
            text, further = (
                part.format(own=keys.pair.public, peer=keys.server_key)
                for part in (words.at_client.text, words.at_client.further)
            )
        return Reason(f"{address} {text}", further)
