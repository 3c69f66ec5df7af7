"""Tunnels through a relay: its messages to a sensing node, and the forwarding of bytes.

A sensing node that nobody can connect to registers at a relay, over ZeroMQ with CURVE, and repeats
that every second. For each tunnel the relay sends a token of one use, with which the node opens a
TCP connection to the relay's next port. The relay joins that connection to a display's. What passes
is the display's own connection to the node's sockets, CURVE included
(docs/decisions/0043-a-tunnel-carries-the-displays-own-connection.md).
"""

import logging
import secrets
import selectors
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from protocol.errors import AddressError, WireError
from protocol.sockets import control_address

logger = logging.getLogger(__name__)

REGISTER, REGISTERED, TAKEN, END = b"register 1", b"registered", b"taken", b"end"
REGISTER_EVERY_NS = 1_000_000_000
# A registration that is not repeated for this time has ended, and so has a relay's answer.
SILENT_NS = 5_000_000_000
CHANNELS = (DATA, CONTROL) = (0, 1)
TOKEN_BYTES = 16
CHUNK_BYTES = 65_536
# Of the kernel, which doubles it: without a bound it stores megabytes for a display that does not
# read. A stream of 1 000 single samples a second takes 0.1 MB/s.
BUFFER_BYTES = 65_536
# As for ZeroMQ's sockets (protocol/sockets.py): a dead peer is found in 10 s, and one that takes
# nothing in 5 s. Systems that lack an option do without it.
_TCP_OPTIONS = {
    "TCP_NODELAY": 1,
    "TCP_KEEPIDLE": 2,
    "TCP_KEEPINTVL": 2,
    "TCP_KEEPCNT": 4,
    "TCP_USER_TIMEOUT": 5_000,
}


def new_token() -> bytes:
    """Return a token that nobody can guess."""
    return secrets.token_bytes(TOKEN_BYTES)


def encode_open(channel: int, token: bytes) -> bytes:
    """Encode a relay's request to open a connection for a channel."""
    return b"open" + bytes([channel]) + token


def decode_open(message: bytes) -> tuple[int, bytes]:
    """Return channel and token of a relay's request. Raises WireError."""
    if len(message) != 5 + TOKEN_BYTES or message[:4] != b"open" or message[4] not in CHANNELS:
        raise WireError("malformed", "the relay sent no request to open a tunnel")
    return message[4], message[5:]


def host_and_port(address: str) -> tuple[str, int]:
    """Return host and port of a tcp:// address; "*" is the empty host. Raises AddressError."""
    control_address(address)
    if not address.startswith("tcp://"):
        raise AddressError(f"{address}: a tunnel needs an address tcp://HOST:PORT")
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    return host.strip("[]").replace("*", ""), int(port)


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens at a host, "" for all interfaces. Raises AddressError."""
    dual = not host and socket.has_dualstack_ipv6()
    family = socket.AF_INET6 if dual or ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family, dualstack_ipv6=dual)
    except OSError as error:
        raise AddressError(f"cannot bind tcp://{host or '*'}:{port}: {error.strerror}") from None
    listener.setblocking(False)
    # Connections inherit it, in time for the handshake that fixes the scale of TCP's window.
    _bound_buffers(listener)
    return listener


def dial(place: tuple[Any, ...]) -> socket.socket:
    """Return a socket that connects to a place of `getaddrinfo`, without waiting for it."""
    connection = socket.socket(socket.AF_INET6 if ":" in place[0] else socket.AF_INET)
    prepare(connection)
    connection.connect_ex(place)
    return connection


def prepare(connection: socket.socket) -> None:
    """Set the options of a tunnel's connection."""
    connection.setblocking(False)
    _bound_buffers(connection)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in _TCP_OPTIONS.items():
        if hasattr(socket, name):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _bound_buffers(connection: socket.socket) -> None:
    for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        connection.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)


class TunnelEnd:
    """A connection at one end of a tunnel. Bytes for it are `pending` until it takes them."""

    __slots__ = ("closing", "connection", "on_first", "peer", "pending")

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.peer: TunnelEnd | None = None
        self.pending = b""
        # Its peer has ended: it is closed once it has taken what is pending.
        self.closing = False
        self.on_first: Callable[[], None] | None = None

    @property
    def is_open(self) -> bool:
        """True until it is closed."""
        return self.connection.fileno() >= 0


class Tunnels:
    """Loop that passes bytes between joined connections, and calls back for other sockets.

    A connection is read only while its peer takes what was read before, so memory is bounded and
    TCP holds the sender back.

    opened: tunnels so far. open: present ones. passed_bytes: in both directions together.
    """

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self.opened = self.open = self.passed_bytes = 0

    def call(self, readable: Any, on_readable: Callable[[], None]) -> None:
        """Call `on_readable` whenever a socket, file or descriptor is readable."""
        self._selector.register(readable, selectors.EVENT_READ, on_readable)

    def forget(self, readable: Any) -> None:
        """End what `call` has begun."""
        self._selector.unregister(readable)

    def add(self, end: TunnelEnd, on_first: Callable[[], None]) -> None:
        """Add an end without a peer, and call `on_first` when it can be read, or has ended."""
        end.on_first = on_first
        self._watch(end)

    def join(self, one: TunnelEnd, other: TunnelEnd, received: bytes) -> None:
        """Join two ends; `received` is what was read from the first one already."""
        one.peer, other.peer = other, one
        one.on_first = other.on_first = None
        other.pending += received
        self.passed_bytes += len(received)
        self.opened += 1
        self.open += 1
        for end in (one, other):
            self._watch(end)

    def close(self, end: TunnelEnd) -> None:
        """Close an end, and its peer once that has taken what is pending."""
        if not end.is_open:
            return
        with suppress(KeyError):
            self._selector.unregister(end.connection)
        end.connection.close()
        peer, end.peer = end.peer, None
        if peer is None:
            return
        self.open -= 1
        peer.peer = None
        peer.closing = True
        if peer.pending:
            self._watch(peer)
        else:
            self.close(peer)

    def run(self, until_ns: int) -> None:
        """Serve sockets until a time, or until something else than bytes of a tunnel has come.

        until_ns: on the monotonic clock; one that has passed serves what is ready.
        """
        wait_ns = until_ns - time.perf_counter_ns()
        while not self._serve(max(0, wait_ns) * 1e-9) and wait_ns > 0:
            wait_ns = until_ns - time.perf_counter_ns()

    def _serve(self, timeout_s: float) -> bool:
        """Serve the sockets that are ready; return whether one of them is no joined connection."""
        others = False
        for key, events in self._selector.select(timeout_s):
            end = key.data
            if not isinstance(end, TunnelEnd):
                end()
                others = True
                continue
            others = others or end.peer is None
            if events & selectors.EVENT_WRITE and end.is_open:
                self._send(end, b"")
            if events & selectors.EVENT_READ and end.is_open:
                self._receive(end)
        return others

    def shut(self) -> None:
        """Close all connections."""
        for key in list(self._selector.get_map().values()):
            if isinstance(key.data, TunnelEnd):
                key.data.connection.close()
        self._selector.close()

    def _receive(self, end: TunnelEnd) -> None:
        if end.on_first is not None:
            end.on_first()
            return
        try:
            data = end.connection.recv(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data or end.peer is None:
            self.close(end)
            return
        self.passed_bytes += len(data)
        self._send(end.peer, data)

    def _send(self, end: TunnelEnd, data: bytes) -> None:
        """Send what is pending and `data`; watch for room where not all of it is taken."""
        before = end.pending
        waiting = before + data
        try:
            sent = end.connection.send(waiting) if waiting else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            end.pending = b""
            self.close(end)
            return
        end.pending = waiting[sent:]
        if end.closing and not end.pending:
            self.close(end)
        elif bool(before) != bool(end.pending):
            self._watch(end)
            if end.peer is not None:
                self._watch(end.peer)

    def _watch(self, end: TunnelEnd) -> None:
        """Wait for what an end can do now: one whose peer has bytes pending is not read."""
        events = selectors.EVENT_WRITE if end.pending else 0
        if not end.closing and not (end.peer is not None and end.peer.pending):
            events |= selectors.EVENT_READ
        with suppress(KeyError):
            self._selector.unregister(end.connection)
        if events:
            self._selector.register(end.connection, events, end)
