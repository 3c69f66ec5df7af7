"""Relay of tunnels, which joins displays to a sensing node that dials out."""

import logging
import math
import socket
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import zmq

from protocol import sockets, tunnel
from protocol.config.quantities import count_text
from protocol.host.process import connections_that_fit
from protocol.run_summary import Summary
from protocol.security.authenticator import TOO_MANY, Authenticator
from protocol.security.budgets import TokenBucket
from protocol.security.keys import ServerKeys
from protocol.security.socket_monitor import HANDSHAKE
from protocol.tunnel import TunnelEnd, Tunnels

logger = logging.getLogger(__name__)

# The first bytes of every ZeroMQ peer (RFC 23). A peer that sends others is no display.
SIGNATURE_BYTES, FIRST_BYTE, LAST_BYTE = 10, 0xFF, 0x7F
# A display sends no more than this before it is answered.
MOST_FIRST_BYTES = 1_024
# Time for a display's first bytes, for a token, and for a sensing node to open a connection.
PROVE_WITHIN_NS = 5_000_000_000
# While no sensing node is registered, displays wait: they would otherwise return at once.
WAIT_FOR_NODE_NS = 10_000_000_000
# Connections that the sensing node holds ready, so that a display need not wait for its dialling.
SPARES = 2
MAX_DISPLAYS = 1_000
# A display takes two connections, up to four over a bad link, and sixteen more where it presses.
MAX_FROM_ONE_ADDRESS, MAX_UNPROVEN = 256, 32
NEW_PER_S, NEW_AT_ONCE, MAX_ADDRESSES = 20, 64, 10_000
MAX_REGISTRATIONS = 64
CHECK_EVERY_NS = 500_000_000
WAIT_NS = 50_000_000
ACCEPT_AT_ONCE = 32


@dataclass(slots=True, eq=False)
class _Unjoined:
    """A connection that is not joined yet, its first bytes, and the time until which it may wait.

    channel: that of a display's connection; None for a connection of the sensing node.
    """

    end: TunnelEnd
    address: str
    channel: int | None
    deadline_ns: int
    received: bytes = b""


@dataclass(slots=True)
class _Registration:
    """The sensing node that displays are joined to. name: that of its key."""

    identity: bytes
    name: str
    repeated_ns: int


class TunnelRelay:
    """Relay that joins displays at `bind` to the sensing node that registers at `nodes`.

    bind: address for displays; control uses the next port. nodes: address at which the sensing
    node registers; it opens its connections to the next port. keys: this relay's keys, with the
    allow-list of sensing nodes; None lets anybody register.

    Raises AddressError or KeyFileError.
    """

    def __init__(self, bind: str, nodes: str, keys: ServerKeys | None = None) -> None:
        self._stopping = False
        self.rejected: Counter[str] = Counter()
        self._tunnels = Tunnels()
        # Each tunnel takes two descriptors.
        self._most = min(MAX_DISPLAYS, connections_that_fit() // 3)
        self._node: _Registration | None = None
        self._registrations = 0
        self._arrivals: dict[str, TokenBucket] = {}
        # Connections whose first bytes are awaited, in the order of arrival.
        self._unproven: list[_Unjoined] = []
        # By channel: displays that wait for the sensing node, and its connections without one.
        self._waiting: tuple[list[_Unjoined], list[_Unjoined]] = ([], [])
        self._spares: tuple[list[TunnelEnd], list[TunnelEnd]] = ([], [])
        # Channel and deadline of each token that was sent and not used.
        self._tokens: dict[bytes, tuple[int, int]] = {}
        self._displays: dict[TunnelEnd, str] = {}
        self._next_check_ns = 0
        host, port = tunnel.host_and_port(nodes)
        context: sockets.Context = zmq.Context()
        self._context = context
        self._authenticator = Authenticator(context, keys, most=MAX_REGISTRATIONS)
        self._registry = sockets.bind(context, zmq.ROUTER, nodes, self._authenticator)
        self._listeners: list[socket.socket] = []
        self._listen(host, port + 1, None)
        host, port = tunnel.host_and_port(bind)
        for channel in tunnel.CHANNELS:
            self._listen(host, port + channel, channel)

    def stop(self) -> None:
        """Make `run` return within 50 ms."""
        self._stopping = True

    def run(self, seconds: float | None = None) -> Summary:
        """Join connections and pass their bytes on until stopped, or for `seconds`."""
        end_ns = math.inf if seconds is None else time.perf_counter_ns() + seconds * 1e9
        zeromq = [self._registry, *self._authenticator.sockets]
        for descriptor in sockets.descriptors(zeromq):
            self._tunnels.call(descriptor, lambda: None)
        try:
            while not self._stopping and (now_ns := time.perf_counter_ns()) < end_ns:
                self._authenticator.poll(now_ns)
                self._receive_registrations(now_ns)
                if now_ns >= self._next_check_ns:
                    self._next_check_ns = now_ns + CHECK_EVERY_NS
                    self._expire(now_ns)
                self._request(now_ns)
                # ZeroMQ's descriptors report changes only, so its sockets are checked first.
                waits = not any(map(sockets.has_message, zeromq))
                self._tunnels.run(now_ns + WAIT_NS if waits else 0)
        finally:
            for listener in self._listeners:
                listener.close()
            self._tunnels.shut()
            self._context.destroy(linger=sockets.LINGER_MS)
        return self._summary()

    def _listen(self, host: str, port: int, channel: int | None) -> None:
        listener = tunnel.listen(host, port)
        self._listeners.append(listener)
        self._tunnels.call(listener, lambda: self._accept(listener, channel))

    def _accept(self, listener: socket.socket, channel: int | None) -> None:
        now_ns = time.perf_counter_ns()
        for _ in range(ACCEPT_AT_ONCE):
            try:
                connection, (host, *_) = listener.accept()
            except OSError:
                return
            address = host.removeprefix("::ffff:")
            if (cause := self._refusal(address, channel, now_ns)) is not None:
                connection.close()
                self._reject(cause, address)
                continue
            tunnel.prepare(connection)
            on_first = self._read_token if channel is None else self._read_display
            unjoined = _Unjoined(
                *(TunnelEnd(connection), address, channel, now_ns + PROVE_WITHIN_NS)
            )
            self._tunnels.add(unjoined.end, self._reader(unjoined, on_first))
            self._unproven.append(unjoined)
            if channel is not None:
                self._displays[unjoined.end] = address

    @staticmethod
    def _reader(unjoined: _Unjoined, read: Callable[[_Unjoined], None]) -> Callable[[], None]:
        return lambda: read(unjoined)

    def _refusal(self, address: str, channel: int | None, now_ns: int) -> str | None:
        """Return why a connection cannot be accepted; make room where it replaces another.

        A peer that sends nothing gives way to the next one from its address.
        """
        silent = [one for one in self._unproven if one.address == address]
        if len(silent) >= MAX_UNPROVEN:
            self._drop(silent[0])
            self._reject(HANDSHAKE, address)
        if len(self._arrivals) > MAX_ADDRESSES:
            self._arrivals.clear()
        bucket = self._arrivals.setdefault(address, TokenBucket(NEW_PER_S, NEW_AT_ONCE))
        if channel is None:
            return TOO_MANY if len(self._unproven) >= self._most else None
        if not bucket.take(now_ns):
            return "flood"
        if len(self._displays) >= self._most:
            return TOO_MANY
        from_it = sum(one == address for one in self._displays.values())
        return TOO_MANY if from_it >= MAX_FROM_ONE_ADDRESS else None

    def _read_display(self, one: _Unjoined) -> None:
        """Read a display's first bytes; join it once they are those of a ZeroMQ peer."""
        received = _received(one.end, MOST_FIRST_BYTES)
        one.received += received
        head = one.received[:SIGNATURE_BYTES]
        proven = len(head) == SIGNATURE_BYTES and head[-1] == LAST_BYTE
        if not received or head[:1] != bytes([FIRST_BYTE]) or len(one.received) > MOST_FIRST_BYTES:
            if one in self._unproven:
                self._reject(HANDSHAKE, one.address)
            self._drop(one)
        elif len(head) == SIGNATURE_BYTES and not proven:
            self._reject(HANDSHAKE, one.address)
            self._drop(one)
        elif proven and one in self._unproven:
            self._unproven.remove(one)
            one.deadline_ns = time.perf_counter_ns() + WAIT_FOR_NODE_NS
            assert one.channel is not None
            self._waiting[one.channel].append(one)
            self._join_waiting(one.channel)

    def _read_token(self, one: _Unjoined) -> None:
        """Read the token of a connection from the sensing node; keep the connection ready."""
        one.received += (received := _received(one.end, tunnel.TOKEN_BYTES - len(one.received)))
        if received and len(one.received) < tunnel.TOKEN_BYTES:
            return
        channel, _ = self._tokens.pop(one.received, (None, 0))
        if channel is None:
            self._reject(HANDSHAKE, one.address)
            self._drop(one)
            return
        self._unproven.remove(one)
        # The node sends nothing until it is joined: what can be read is the connection's end.
        one.end.on_first = lambda: self._drop(one)
        self._spares[channel].append(one.end)
        self._join_waiting(channel)

    def _join_waiting(self, channel: int) -> None:
        waiting, spares = self._waiting[channel], self._spares[channel]
        while waiting and spares:
            display = waiting.pop(0)
            self._tunnels.join(display.end, spares.pop(0), display.received)

    def _receive_registrations(self, now_ns: int) -> None:
        for _ in range(sockets.MAX_MESSAGES):
            if not sockets.has_message(self._registry):
                return
            identity, *_, message = self._registry.recv_multipart(zmq.NOBLOCK, copy=False)
            name = ""
            with suppress(zmq.ZMQError):  # there is no name without keys
                name = str(message.get("User-Id"))
            self._register(identity.bytes, name, message.bytes, now_ns)

    def _register(self, identity: bytes, name: str, message: bytes, now_ns: int) -> None:
        """Register the node of that key, or of that connection where there are no keys.

        While one is registered, others are answered that the place is taken. A node that has
        started again, or whose connection has been replaced, is known by its key.
        """
        node = self._node
        same = node is not None and (node.identity == identity or node.name == name != "")
        if message == tunnel.END and node is not None and node.identity == identity:
            self._forget_node("has ended")
        if message != tunnel.REGISTER:
            return
        if node is not None and not same:
            sockets.send(self._registry, identity, tunnel.TAKEN)
            return
        if node is None or node.identity != identity:
            self._forget_node("has registered again")
            self._registrations += 1
            logger.info(f"sensing node {name or 'without a key'} has registered")
        self._node = _Registration(identity, name, now_ns)
        sockets.send(self._registry, identity, tunnel.REGISTERED)

    def _forget_node(self, why: str) -> None:
        """End the registration and what it has opened in advance; tunnels continue."""
        if self._node is None:
            return
        logger.info(f"sensing node {self._node.name or 'without a key'} {why}")
        self._node = None
        self._tokens.clear()
        for spares in self._spares:
            while spares:
                self._tunnels.close(spares.pop())

    def _request(self, now_ns: int) -> None:
        """Request as many connections of the node as displays wait for, and some spare ones."""
        if self._node is None:
            return
        for channel in tunnel.CHANNELS:
            requested = sum(of == channel for of, _ in self._tokens.values())
            there = requested + len(self._spares[channel])
            for _ in range(len(self._waiting[channel]) + SPARES - there):
                token = tunnel.new_token()
                self._tokens[token] = channel, now_ns + PROVE_WITHIN_NS
                message = tunnel.encode_open(channel, token)
                sockets.send(self._registry, self._node.identity, message)

    def _expire(self, now_ns: int) -> None:
        """Close what has waited too long, and forget a silent node."""
        if self._node is not None and now_ns - self._node.repeated_ns > tunnel.SILENT_NS:
            self._forget_node("is silent")
        for one in [*self._unproven, *self._waiting[0], *self._waiting[1]]:
            if now_ns > one.deadline_ns:
                if one in self._unproven:
                    self._reject(HANDSHAKE, one.address)
                self._drop(one)
        self._tokens = {t: (c, ns) for t, (c, ns) in self._tokens.items() if ns >= now_ns}
        self._displays = {end: a for end, a in self._displays.items() if end.is_open}

    def _drop(self, one: _Unjoined) -> None:
        for group in (self._unproven, *self._waiting):
            if one in group:
                group.remove(one)
        for spares in self._spares:
            if one.end in spares:
                spares.remove(one.end)
        self._displays.pop(one.end, None)
        self._tunnels.close(one.end)

    def _reject(self, cause: str, address: str) -> None:
        self.rejected[cause] += 1
        if self.rejected[cause] == 1:
            logger.warning(f"refused {address}: {cause}; further ones are counted")

    def _summary(self) -> Summary:
        logger.info(
            f"{count_text(self._tunnels.opened, 'tunnel')} carried"
            f" {self._tunnels.passed_bytes * 1e-6:.1f} MB;"
            f" {count_text(self._registrations, 'registration')} of a sensing node"
        )
        return Summary(rejected=dict(self.rejected + self._authenticator.rejected))


def _received(end: TunnelEnd, most_bytes: int) -> bytes:
    """Return what can be read; nothing once the connection has ended."""
    try:
        return end.connection.recv(most_bytes)
    except OSError:
        return b""
