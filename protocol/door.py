"""The connections that others make to a bound socket: which fail, and how one is cut.

ZeroMQ tells of them by descriptor, and has no call that ends one; its own descriptor does.
"""

import os
import socket as plain
import struct
from contextlib import suppress

import zmq

from protocol.sockets import Context, Socket
from protocol.watch import FAILURES, HANDSHAKE, Watch, cause_of

_EVENTS = (
    zmq.EVENT_ACCEPTED
    | zmq.EVENT_HANDSHAKE_SUCCEEDED
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
    | FAILURES
    | zmq.EVENT_DISCONNECTED
)
_ANSWERED = "answered"
# A connection that is closed so leaves nothing behind that its peer could still read.
_NO_LINGER = struct.pack("hh" if os.name == "nt" else "ii", 1, 0)


class Door:
    """The open connections of one bound socket, by descriptor, with the address of each.

    ZeroMQ does not say which connection has become one, nor of each that does not: the longest
    open is taken for it. So the count is right, though not always at once.

    socket: to wait for.
    """

    def __init__(self, context: Context, bound: Socket) -> None:
        """Before `bound` is bound."""
        self._watch = Watch(context, bound, _EVENTS)
        self.socket = self._watch.socket
        self._open: dict[int, str] = {}
        self._fresh: dict[int, None] = {}
        # Of a failure whose end may be told next.
        self._failed: str | None = None

    def failures(self) -> list[tuple[str, str]]:
        """Cause and address of each connection that failed since the last call.

        Those that were refused for their key are not among them: who refused them knows.
        """
        failures: list[tuple[str, str]] = []
        kept = self._failed
        for event, value, _ in self._watch.events():
            if event == zmq.EVENT_DISCONNECTED:
                failures += self._end(value)
            else:
                failures += self._fail("")
            if event == zmq.EVENT_ACCEPTED:
                self._open[value] = _address_of(value)
                self._fresh[value] = None
            elif event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self._settle()
            elif event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
                self._failed = _ANSWERED
            elif event != zmq.EVENT_DISCONNECTED:
                self._failed = cause_of(value)
            kept = None
        # ZeroMQ keeps a connection whose message could not be opened: its end does not come.
        return failures + (self._fail("") if kept is not None else [])

    def cut(self, addresses: set[str] | None) -> None:
        """Cut the connections from `addresses`, or all."""
        for descriptor, address in self._open.items():
            if addresses is None or address in addresses:
                cut(descriptor, address)

    def _end(self, descriptor: int) -> list[tuple[str, str]]:
        """A connection has ended; the failure, if that is why."""
        address = self._open.pop(descriptor, "")
        if self._failed is None:
            if descriptor not in self._fresh:
                return []
            self._failed = HANDSHAKE
        self._settle(descriptor)
        return self._fail(address)

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
