"""Reasons why a connection to another node fails. ZeroMQ would try for ever, in silence."""

from collections import Counter
from collections.abc import Callable

import zmq

from protocol.security.keys import ClientKeys
from protocol.security.socket_monitor import (
    FAILURES,
    HANDSHAKE,
    NO_KEY,
    NOT_AUTHENTIC,
    REPLAYED,
    SocketMonitor,
    cause_of,
)
from protocol.sockets import Context, Socket

LOOK_EVERY_NS = 10_000_000
REFUSED_KEY, REVOKED = "refused_key", "revoked"
# A node that ends breaks off, too; who does so again and again has another reason.
BREAKS = 3
_EVENTS = (
    zmq.EVENT_CONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_HANDSHAKE_FAILED_AUTH | FAILURES
)


class HandshakeMonitor:
    """Counts what connecting sockets are refused, says each reason once, and tells which requests
    to connect were answered.

    rejected: how often, by cause.
    """

    def __init__(
        self, context: Context, keys: ClientKeys | None, log: Callable[[str], None]
    ) -> None:
        self._context = context
        self._keys = keys
        self._log = log
        self._watches: list[tuple[Socket, SocketMonitor]] = []
        self._breaks: Counter[str] = Counter()
        # Hosts that have allowed our key: one that refuses it later has revoked it.
        self._allowed: set[str] = set()
        self._said: set[tuple[str, str]] = set()
        self._look_ns = 0
        self.rejected: Counter[str] = Counter()

    def watch(self, socket: Socket) -> None:
        """Listen to a socket; before it connects."""
        self._watches.append((socket, SocketMonitor(self._context, socket, _EVENTS)))

    def tend(self, now_ns: int) -> list[Socket]:
        """Hear what has happened; call it often. Returns the sockets to whose request to connect
        a host has answered, whatever comes of it."""
        if now_ns < self._look_ns:
            return []
        self._look_ns = now_ns + LOOK_EVERY_NS
        answered = []
        for socket, watch in self._watches:
            for event, value, endpoint in watch.events():
                if event == zmq.EVENT_CONNECTED:
                    answered.append(socket)
                else:
                    self._on_event(event, value, endpoint)
        return answered

    def _on_event(self, event: int, value: int, endpoint: str) -> None:
        # Data and control of a node have one reason.
        host = endpoint.rpartition(":")[0]
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._breaks[host] = 0
            self._allowed.add(host)
            # If it is revoked again, that is reported again.
            self._said.discard((REVOKED, host))
            return
        if event != zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            cause = cause_of(value)
        else:
            cause = REVOKED if host in self._allowed else REFUSED_KEY
        self.rejected[cause] += 1
        if cause == HANDSHAKE:
            self._breaks[host] += 1
            if self._breaks[host] < BREAKS:
                return
        if (cause, host) not in self._said:
            self._said.add((cause, host))
            self._log(f"{endpoint} {self._reason(cause)}")

    def _reason(self, cause: str) -> str:
        if self._keys is None:
            return {
                NO_KEY: "lets in who has a key; give --key and --peer",
            }.get(cause, "is no node, or breaks off as soon as it is connected")
        own, peer = self._keys.own.name, self._keys.peer.name
        return {
            REFUSED_KEY: f"does not allow the key of {own}; there: telepulse keys allow {own}.pub",
            REVOKED: f"has revoked the key of {own}: this node was connected and is allowed no"
            f" more; to undo that, there: telepulse keys allow {own}.pub",
            NO_KEY: "has no keys; start it with --key, or this node with --insecure",
            NOT_AUTHENTIC: f"sends what {peer} has not sealed, or what was altered on the way",
            REPLAYED: "sends messages twice or in another order",
        }.get(cause, f"breaks off: it is not {peer}, whose public key --peer gives")
