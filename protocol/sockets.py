"""ZeroMQ sockets: addresses, heartbeats, limits.

One address names a stream. Data is PUB to SUB there; control is ROUTER to DEALER one port
higher (for ipc: the path with ".control" behind it). Reconnecting is ZeroMQ's own; heartbeats
let go of a peer that is dead or beyond a cut.
"""

import errno
import re
import select
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import cast

import zmq

from protocol.errors import AddressError
from protocol.messages import MAX_FRAME_BYTES

HEARTBEAT_MS = 2_000
# Far longer than TCP stalls on a bad link: a connection given up loses all that queued on it. Who
# has to know of a silence sooner watches for it, as a display does.
HEARTBEAT_TIMEOUT_MS = 10_000
RECONNECT_MS = 100
HIGH_WATER_FRAMES = 1_000
LINGER_MS = 500
MAX_MESSAGES = 200
MAX_PORT = 65_535

Context = zmq.Context[zmq.Socket[bytes]]
Socket = zmq.Socket[bytes]
_TCP = re.compile(r"tcp://(?P<host>[^\s/]+):(?P<port>\d{1,5})")
_LOOPBACK = re.compile(r"(127\.\d+\.\d+\.\d+|localhost|\[::1\])")
_HINTS = {
    zmq.EADDRINUSE: "; another program holds it",
    zmq.EADDRNOTAVAIL: "; this machine does not have it",
    errno.ENODEV: "; this machine does not have it",
}


def control_address(address: str) -> str:
    """The control address that belongs to a data address. Raises AddressError."""
    match = _TCP.fullmatch(address)
    if match and 0 < int(match["port"]) < MAX_PORT:
        return f"tcp://{match['host']}:{int(match['port']) + 1}"
    if address.startswith("ipc://") and len(address) > len("ipc://"):
        return address + ".control"
    raise AddressError(
        f"{address}: not an address; write tcp://HOST:PORT with a port of 1 to 65534, or ipc://PATH"
    )


def beyond_loopback(address: str) -> bool:
    """Whether the address can be reached from, or reaches, another machine."""
    host = address.removeprefix("tcp://").rpartition(":")[0]
    return address.startswith("tcp://") and _LOOPBACK.fullmatch(host) is None


def bind(context: Context, kind: int, address: str) -> Socket:
    """A socket of `kind` bound to `address`. Raises AddressError."""
    socket = _socket_for(context, kind, address)
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        socket.close(0)
        raise AddressError(f"cannot bind {address}: {_reason(error)}") from None
    return socket


def connect(context: Context, kind: int, address: str) -> Socket:
    """A socket of `kind` that connects to `address`, now or when it appears."""
    socket = _socket_for(context, kind, address)
    try:
        socket.connect(address)
    except zmq.ZMQError as error:
        socket.close(0)
        raise AddressError(f"cannot connect to {address}: {_reason(error)}") from None
    return socket


def unconnected(context: Context, kind: int) -> Socket:
    """A socket of `kind` for `reconnect` to connect."""
    socket = context.socket(kind)
    socket.setsockopt(zmq.LINGER, LINGER_MS)
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_FRAMES)
    socket.setsockopt(zmq.RCVHWM, HIGH_WATER_FRAMES)
    socket.setsockopt(zmq.HEARTBEAT_IVL, HEARTBEAT_MS)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, HEARTBEAT_TIMEOUT_MS)
    socket.setsockopt(zmq.HEARTBEAT_TTL, HEARTBEAT_TIMEOUT_MS)
    socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
    # A little above what is decoded, so that an oversized message is counted, not only cut off.
    socket.setsockopt(zmq.MAXMSGSIZE, 4 * MAX_FRAME_BYTES)
    return socket


def reconnect(socket: Socket, old: str | None, new: str) -> None:
    """Connect to `new` instead of `old`; the two may be the same.

    ZeroMQ reconnects by itself, but not after a peer broke the protocol, as with a message
    above our size limit: then the connection is gone for good.
    """
    if old is not None:
        with suppress(zmq.ZMQError):  # it may know the address no more
            socket.disconnect(old)
    socket.setsockopt(zmq.IPV6, "[" in new)
    socket.connect(new)


def receive_all(socket: Socket) -> Iterator[list[bytes]]:
    """The messages that wait, without blocking; a message is its list of parts.

    At most `MAX_MESSAGES` a call, so that a flood cannot keep a loop from its ticks.
    """
    for _ in range(MAX_MESSAGES):
        if not _has_message(socket):
            return
        yield socket.recv_multipart(zmq.NOBLOCK)


def receive_each(socket: Socket) -> Iterator[bytes]:
    """As `receive_all` where a message has one part; of one with several, each is a message.

    The quickest way to a frame: the socket is asked for nothing but the message.
    """
    for _ in range(MAX_MESSAGES):
        try:
            message = socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return
        yield message


def send(socket: Socket, *parts: bytes) -> bool:
    """Send without blocking; False when the peer cannot take it now."""
    try:
        if len(parts) == 1:
            socket.send(parts[0], zmq.NOBLOCK)
        else:
            socket.send_multipart(parts, zmq.NOBLOCK)
    except zmq.Again:
        return False
    return True


def wait_readable(sockets: Sequence[Socket], timeout_ns: int) -> None:
    """Sleep until a socket may have something to read, or the time is over.

    ZeroMQ's own poll counts whole milliseconds, too coarse for a 1 kHz loop. Its descriptors
    are edge-triggered, and sending uses the edge up too: so each socket is asked first.
    """
    if timeout_ns > 0 and not any(_has_message(socket) for socket in sockets):
        wait_drained(descriptors(sockets), timeout_ns)


def wait_drained(numbers: Sequence[int], timeout_ns: int) -> None:
    """As `wait_readable`, for `descriptors` of sockets that were all read to their end since
    anything was sent on them, so that there is no need to ask them again.

    What was left on a socket nevertheless waits for the next message or the time's end.
    """
    if timeout_ns > 0:
        select.select(numbers, (), (), timeout_ns * 1e-9)


def descriptors(sockets: Sequence[Socket]) -> list[int]:
    """What to wait for each socket by; it stays the same as long as the socket."""
    return [cast(int, socket.getsockopt(zmq.FD)) for socket in sockets]


def _has_message(socket: Socket) -> bool:
    return bool(cast(int, socket.getsockopt(zmq.EVENTS)) & zmq.POLLIN)


def _reason(error: zmq.ZMQError) -> str:
    number = error.errno or 0
    return zmq.strerror(number) + _HINTS.get(number, "")


def _socket_for(context: Context, kind: int, address: str) -> Socket:
    match = _TCP.fullmatch(address)
    if match and int(match["port"]) > MAX_PORT:
        # ZeroMQ takes it modulo 65536.
        raise AddressError(f"{address}: there is no such port; the highest is {MAX_PORT}")
    socket = unconnected(context, kind)
    socket.setsockopt(zmq.IPV6, "[" in address)
    return socket
