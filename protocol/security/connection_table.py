"""The connections that others make to a bound socket: which fail, and how one is cut.

ZeroMQ tells of them by descriptor, and has no call that ends one; its own descriptor does. Nor has
it one that takes no more of them for a while; a filter on the listening socket does.
"""

import ctypes
import itertools
import os
import socket as plain
import struct
import sys
from collections import Counter
from contextlib import suppress

import zmq

from protocol.security.socket_monitor import FAILURES, HANDSHAKE, SocketMonitor, cause_of
from protocol.sockets import Context, Socket

_EVENTS = (
    zmq.EVENT_ACCEPTED
    | zmq.EVENT_HANDSHAKE_SUCCEEDED
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
    | FAILURES
    | zmq.EVENT_DISCONNECTED
    | zmq.EVENT_LISTENING
)
# So many are read a call: some 0.2 ms of a loop.
MAX_EVENTS = 16
_ANSWERED = "answered"
_turns = itertools.count()
# A connection that is closed so leaves nothing behind that its peer could still read.
_NO_LINGER = struct.pack("hh" if os.name == "nt" else "ii", 1, 0)
# From <asm-generic/socket.h>; a filter of one instruction, BPF_RET, by which no packet passes.
_SO_ATTACH_FILTER, _SO_DETACH_FILTER = 26, 27
_DROP_ALL = ctypes.create_string_buffer(struct.pack("HBBI", 0x06, 0, 0, 0))


class ConnectionTable:
    """The open connections of one bound socket, by descriptor, with the address of each.

    ZeroMQ does not say which connection has become one, nor of each that does not: the longest
    open is taken for it. So the count is right, though not always at once.

    socket: to wait for. behind: whether more has happened than was read of it. by_address: how many
    connections are open, by where they come from; those that were cut are not among them.
    """

    def __init__(self, context: Context, bound: Socket) -> None:
        """Before `bound` is bound."""
        self._watch = SocketMonitor(context, bound, _EVENTS)
        self.socket = self._watch.socket
        self.behind = False
        self.by_address: Counter[str] = Counter()
        self._listening: list[int] = []
        self._shut = False
        self._open: dict[int, str] = {}
        self._cut: set[int] = set()
        # With the turn in which each came, over all doors.
        self._fresh: dict[int, int] = {}
        # Of a failure whose end may be told next.
        self._failed: str | None = None

    def failures(self) -> list[tuple[str, str]]:
        """Cause and address of each connection that failed since the last call.

        Those that were refused for their key are not among them: who refused them knows.
        """
        failures: list[tuple[str, str]] = []
        kept = self._failed
        read = 0
        for event, value, _ in self._watch.events(MAX_EVENTS):
            read += 1
            if event == zmq.EVENT_LISTENING:
                self._listening.append(value)
                continue
            if event == zmq.EVENT_DISCONNECTED:
                failures += self._end(value)
            else:
                failures += self._fail("")
            if event == zmq.EVENT_ACCEPTED:
                self._forget(value)
                self._open[value] = address = _address_of(value)
                self.by_address[address] += 1
                self._fresh.pop(value, None)
                self._fresh[value] = next(_turns)
            elif event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self._settle()
            elif event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
                self._failed = _ANSWERED
            elif event != zmq.EVENT_DISCONNECTED:
                self._failed = cause_of(value)
            kept = None
        self.behind = read == MAX_EVENTS
        # ZeroMQ keeps a connection whose message could not be opened: its end does not come.
        return failures + (self._fail("") if kept is not None else [])

    @property
    def connections(self) -> int:
        """The number of connections that are open and were not cut."""
        return len(self._open) - len(self._cut)

    def pending(self) -> list[tuple[int, int, str]]:
        """Return turn, descriptor and address of each that is not yet one of ZeroMQ's."""
        return [
            (turn, number, self._open[number])
            for number, turn in self._fresh.items()
            if number in self._open and number not in self._cut
        ]

    @property
    def most_pending(self) -> int:
        """A bound on how many are no ZeroMQ connection yet, which costs nothing to ask for."""
        return len(self._fresh)

    def newest_from(self, address: str, most: int) -> list[int]:
        """Return the descriptors of the newest connections from an address, `most` at most."""
        of_it = (n for n in reversed(self._open) if self._open[n] == address and n not in self._cut)
        return list(itertools.islice(of_it, most))

    def cut(self, addresses: set[str] | None) -> None:
        """Cut the connections from `addresses`, or all."""
        for descriptor, address in self._open.items():
            if addresses is None or address in addresses:
                cut(descriptor, address)

    def cut_one(self, descriptor: int) -> None:
        """Cut one connection; it counts no longer, though ZeroMQ has still to close it."""
        address = self._open[descriptor]
        cut(descriptor, address)
        self._cut.add(descriptor)
        self.by_address[address] -= 1

    def shut(self, shut: bool) -> None:
        """Take no further connections, or take them again; those that are open stay. Linux, TCP.

        The kernel drops requests to connect, which their senders repeat.
        """
        if shut == self._shut or sys.platform != "linux":
            return
        self._shut = shut
        option, value = (
            (_SO_ATTACH_FILTER, struct.pack("HP", 1, ctypes.addressof(_DROP_ALL)))
            if shut
            else (_SO_DETACH_FILTER, struct.pack("i", 0))
        )
        for number in self._listening:
            with suppress(OSError):
                listening = plain.socket(fileno=number)
                try:
                    listening.setsockopt(plain.SOL_SOCKET, option, value)
                finally:
                    listening.detach()

    def _end(self, descriptor: int) -> list[tuple[str, str]]:
        """A connection has ended; the failure, if that is why."""
        address = self._forget(descriptor)
        if self._failed is None:
            if descriptor not in self._fresh:
                return []
            self._failed = HANDSHAKE
        self._settle(descriptor)
        return self._fail(address)

    def _forget(self, descriptor: int) -> str:
        """Drop a connection from the table; return its address."""
        address = self._open.pop(descriptor, None)
        if address is None:
            return ""
        if descriptor not in self._cut:
            self.by_address[address] -= 1
        self._cut.discard(descriptor)
        if not self.by_address[address]:
            del self.by_address[address]
        return address

    def _fail(self, address: str) -> list[tuple[str, str]]:
        """The failure that was told last, if one waits for its address."""
        cause, self._failed = self._failed, None
        return [] if cause in (None, _ANSWERED) else [(cause, address)]

    def _settle(self, descriptor: int | None = None) -> None:
        """A fresh connection is no longer; which, if not known, the oldest."""
        if descriptor not in self._fresh:
            descriptor = next(iter(self._fresh), None)
        if descriptor is not None:
            del self._fresh[descriptor]


def _address_of(descriptor: int) -> str:
    """Whence a connection comes; empty over ipc, and for one that has ended meanwhile."""
    with suppress(OSError):
        connection = plain.socket(fileno=descriptor)
        try:
            name = connection.getpeername()
        finally:
            connection.detach()
        if isinstance(name, tuple):
            return str(name[0])
    return ""


def cut(descriptor: int, address: str) -> None:
    """End a connection of ZeroMQ's own; ZeroMQ notices, and closes it.

    address: whence it comes, empty over ipc.
    """
    with suppress(OSError):
        connection = plain.socket(fileno=descriptor)
        try:
            # The number may stand for something else by now.
            if _address_of(descriptor) == address:
                connection.setsockopt(plain.SOL_SOCKET, plain.SO_LINGER, _NO_LINGER)
                connection.shutdown(plain.SHUT_RDWR)
        finally:
            connection.detach()
