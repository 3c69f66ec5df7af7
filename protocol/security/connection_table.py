"""Connections of peers to bound sockets: the open ones, the failed ones, their greatest number.

ZeroMQ reports connections by file descriptor. It has no call that ends one, so its descriptor is
shut down. It has no call that pauses accepting either, so a packet filter is attached to the
listening socket (docs/decisions/0031-zmq-auth-is-not-enough.md).
"""

import ctypes
import itertools
import os
import socket as plain
import struct
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from statistics import mode

import zmq

from protocol.refusals import HANDSHAKE
from protocol.security.handshakes import FAILURES, SocketMonitor, cause_of
from protocol.sockets import Context, Socket

_EVENTS = (
    zmq.EVENT_ACCEPTED
    | zmq.EVENT_HANDSHAKE_SUCCEEDED
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
    | FAILURES
    | zmq.EVENT_DISCONNECTED
    | zmq.EVENT_LISTENING
)
# Number of events read in a call, which takes some 0.2 ms of a loop.
MAX_EVENTS = 16
# A socket whose events could not all be read for this time stops accepting connections.
BEHIND_NS = 100_000_000
MAX_CUTS = 32
# Stands for the events of a call in which there are none.
_NO_EVENT = (0, -1, "")
_order = itertools.count()
# With this, closing discards queued data, so that the peer cannot read it.
_NO_LINGER = struct.pack("hh" if os.name == "nt" else "ii", 1, 0)
# From <asm-generic/socket.h>; a filter of one instruction, BPF_RET 0, which drops every packet.
_SO_ATTACH_FILTER, _SO_DETACH_FILTER = 26, 27
_DROP_ALL = ctypes.create_string_buffer(struct.pack("HBBI", 0x06, 0, 0, 0))


class ConnectionTable:
    """Open connections of one bound socket, by descriptor, with the address of each.

    The events of one connection, of which only the first and the last have its descriptor:

    ================================== ==================================================
    accepted, succeeded, disconnected  established
    accepted, succeeded, failed        established; a message cannot be decrypted
    accepted, failed, disconnected     failed for the event's cause
    accepted, refused, disconnected    refused for its key; ends a round trip later
    accepted, disconnected             failed for the cause `HANDSHAKE`
    ================================== ==================================================

    Nothing comes between a failed connection's last two events. Between the others there may be any
    events of other connections. So the oldest pending connections are assumed to be those that were
    refused, the next one that which has succeeded, and one that ends while refused ones are pending
    to be one of these. Counts may be wrong until the connections end.

    socket: readable when events wait. behind: more events may wait than the last call has read.
    by_address: counts of open connections that were not cut.
    """

    def __init__(self, context: Context, bound: Socket) -> None:
        """Watch `bound`; call this before it is bound."""
        self._monitor = SocketMonitor(context, bound, _EVENTS)
        self.socket = self._monitor.socket
        self.behind = False
        self.by_address: Counter[str] = Counter()
        self._listening: list[int] = []
        self._paused = False
        self._open: dict[int, str] = {}
        self._cut: set[int] = set()
        # Descriptor → number in the order of arrival, common to all tables.
        self._pending: dict[int, int] = {}
        # Number of pending connections that were refused for their key.
        self._refused = 0
        # Cause, where the last event was a failure: the next one may be its disconnection.
        self._failure: str | None = None

    def failures(self) -> list[tuple[str, str]]:
        """Return cause and address of each connection that failed since the last call.

        Connections that were refused for their key are left out: the authenticator counts those.
        """
        failures: list[tuple[str, str]] = []
        events = list(self._monitor.events(MAX_EVENTS))
        self.behind = len(events) == MAX_EVENTS
        for event, value, _ in events or [_NO_EVENT]:
            cause, self._failure = self._failure, None
            if event == zmq.EVENT_DISCONNECTED:
                failures += self._end(value, cause)
                continue
            if cause is not None:
                failures.append((cause, ""))
            if event == zmq.EVENT_ACCEPTED:
                self._begin(value)
            elif event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self._settle()
            elif event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
                self._refused += 1
            elif event == zmq.EVENT_LISTENING:
                self._listening.append(value)
            elif event & FAILURES:
                self._failure = cause_of(value)
        return failures

    @property
    def connections(self) -> int:
        """Number of connections that are open and were not cut."""
        return len(self._open) - len(self._cut)

    @property
    def most_pending(self) -> int:
        """Upper bound of the number of pending connections, without a search."""
        return len(self._pending)

    def pending(self) -> list[tuple[int, int, str]]:
        """Return order, descriptor and address of each connection without a ZeroMQ handshake."""
        return [
            (order, descriptor, self._open[descriptor])
            for descriptor, order in self._pending.items()
            if descriptor in self._open and descriptor not in self._cut
        ]

    def newest_from(self, address: str, most: int) -> list[int]:
        """Return the descriptors of up to `most` newest connections from an address."""
        of_it = (n for n in reversed(self._open) if self._open[n] == address and n not in self._cut)
        return list(itertools.islice(of_it, most))

    def cut_from(self, addresses: set[str] | None) -> None:
        """Cut the connections from `addresses`; None: all connections."""
        for descriptor, address in self._open.items():
            if descriptor not in self._cut and (addresses is None or address in addresses):
                self.cut(descriptor)

    def cut(self, descriptor: int) -> None:
        """Cut one connection. It is not counted any more, although ZeroMQ closes it later."""
        address = self._open[descriptor]
        shut_down(descriptor, address)
        self._cut.add(descriptor)
        self.by_address[address] -= 1

    def pause(self, paused: bool) -> None:
        """Pause or resume accepting connections (TCP on Linux); open connections stay.

        During a pause the kernel drops requests to connect, which their senders repeat.
        """
        if paused == self._paused or sys.platform != "linux":
            return
        self._paused = paused
        option, value = (
            (_SO_ATTACH_FILTER, struct.pack("HP", 1, ctypes.addressof(_DROP_ALL)))
            if paused
            else (_SO_DETACH_FILTER, struct.pack("i", 0))
        )
        for descriptor in self._listening:
            with suppress(OSError), _socket_of(descriptor) as listening:
                listening.setsockopt(plain.SOL_SOCKET, option, value)

    def _begin(self, descriptor: int) -> None:
        """Add a connection that was accepted."""
        self._forget(descriptor)
        self._open[descriptor] = address = _address_of(descriptor)
        self.by_address[address] += 1
        self._pending.pop(descriptor, None)
        self._pending[descriptor] = next(_order)

    def _end(self, descriptor: int, cause: str | None) -> list[tuple[str, str]]:
        """Remove a connection that has ended; return its failure, for `cause` if that is given."""
        address = self._forget(descriptor)
        if cause is None and descriptor not in self._pending:
            return []
        self._settle(descriptor)
        if cause is None and self._refused:
            self._refused -= 1
            return []
        return [(cause or HANDSHAKE, address)]

    def _forget(self, descriptor: int) -> str:
        """Remove a connection from the table; return its address."""
        address = self._open.pop(descriptor, None)
        if address is None:
            return ""
        if descriptor not in self._cut:
            self.by_address[address] -= 1
        self._cut.discard(descriptor)
        if not self.by_address[address]:
            del self.by_address[address]
        return address

    def _settle(self, descriptor: int | None = None) -> None:
        """End a connection's pending state, or that of the oldest one that was not refused."""
        if descriptor not in self._pending:
            descriptor = next(itertools.islice(self._pending, self._refused, None), None)
        if descriptor is not None:
            del self._pending[descriptor]


class ConnectionBudget:
    """Bound on the open connections of several sockets together.

    A peer that connects repeatedly must not exhaust the process's file descriptors, its memory or
    its loop's time, and earlier connections must stay. Too many pending connections: the oldest
    ones from the address with most of them are cut. Too many established ones: the newest from the
    address with most of them are cut. So a single address never blocks the others.

    most: greatest number of open connections. Half of them may be pending (no ZeroMQ handshake
    yet), three quarters may come from one address.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._most_pending = most // 2
        self._most_from_one = most * 3 // 4
        self._behind_since_ns: dict[ConnectionTable, int] = {}

    def enforce(self, tables: Sequence[ConnectionTable], now_ns: int) -> list[str]:
        """Cut the connections above the budget; return the address of each."""
        for table in tables:
            if not table.behind:
                self._behind_since_ns.pop(table, None)
                table.pause(False)
            elif now_ns - self._behind_since_ns.setdefault(table, now_ns) >= BEHIND_NS:
                table.pause(True)
        return [*self._cut_pending(tables), *self._cut_established(tables)]

    def _cut_pending(self, tables: Sequence[ConnectionTable]) -> list[str]:
        if sum(table.most_pending for table in tables) <= self._most_pending:
            return []
        pending = [(*one, table) for table in tables for one in table.pending()]
        beyond = min(len(pending) - self._most_pending, MAX_CUTS)
        if beyond <= 0:
            return []
        most_of = mode(address for _, _, address, _ in pending)
        oldest = sorted(one for one in pending if one[2] == most_of)[:beyond]
        for _, descriptor, _, table in oldest:
            table.cut(descriptor)
        return [most_of] * len(oldest)

    def _cut_established(self, tables: Sequence[ConnectionTable]) -> list[str]:
        total = sum(table.connections for table in tables)
        if total <= self._most_from_one:
            return []
        by_address = sum((table.by_address for table in tables), Counter[str]())
        (most_of, count), *_ = by_address.most_common(1)
        beyond = min(max(total - self.most, count - self._most_from_one), MAX_CUTS)
        addresses: list[str] = []
        for table in sorted(tables, key=lambda table: -table.by_address[most_of]):
            for descriptor in table.newest_from(most_of, beyond - len(addresses)):
                table.cut(descriptor)
                addresses.append(most_of)
        return addresses


def shut_down(descriptor: int, address: str) -> None:
    """Shut down the connection of a descriptor that ZeroMQ owns; ZeroMQ then closes it.

    It does nothing unless the peer's address is still `address` ("" over ipc), since the number may
    belong to another connection by now.
    """
    with suppress(OSError), _socket_of(descriptor) as connection:
        if _address_of(descriptor) == address:
            connection.setsockopt(plain.SOL_SOCKET, plain.SO_LINGER, _NO_LINGER)
            connection.shutdown(plain.SHUT_RDWR)


def _address_of(descriptor: int) -> str:
    """Return the peer's IP address; "" over ipc, and for a connection that has ended."""
    with suppress(OSError), _socket_of(descriptor) as connection:
        name = connection.getpeername()
        if isinstance(name, tuple):
            return str(name[0])
    return ""


@contextmanager
def _socket_of(descriptor: int) -> Iterator[plain.socket]:
    """Use ZeroMQ's descriptor as a socket within a `with`, and leave it open. Raises OSError."""
    borrowed = plain.socket(fileno=descriptor)
    try:
        yield borrowed
    finally:
        borrowed.detach()
