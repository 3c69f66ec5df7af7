"""ZeroMQ sockets: addresses, keepalive, limits.

One address names a stream. Data is PUB to SUB there; control is ROUTER to DEALER one port
higher (for ipc: the path with ".control" behind it). Reconnecting is ZeroMQ's own; the
kernel's keepalive lets go of a peer that is dead or beyond a cut.
"""

import errno
import os
import re
import select
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

import zmq

from protocol.errors import AddressError
from protocol.security.keys import ClientKeys
from protocol.wire.messages import MAX_FRAME_BYTES

if TYPE_CHECKING:
    from protocol.security.authenticator import Authenticator

# The kernel asks whether a silent peer is there. ZeroMQ's own heartbeats end the whole process
# where a peer goes that had filled our queue (libzmq 4.3.5, its issues 3937 and 4364).
KEEPALIVE_S = 2
KEEPALIVE_PROBES = 4
# What a peer has not acknowledged, or has no room for, for so long: it does not read any more, and
# what queues for it gets old. Longer than a display is patient with a silent connection.
STUCK_MS = 5_000
RECONNECT_MS = 20
HIGH_WATER_FRAMES = 1_000
LINGER_MS = 500
MAX_MESSAGES = 200
# Who publishes hears nothing but subscriptions (protocol/security/subscription_budget.py).
_FOR_SUBSCRIPTIONS: dict[int, int] = {
    # Each is told of, not the first alone: else one peer's topics hide behind another's.
    zmq.XPUB_VERBOSE: 1,
    # While some wait, ZeroMQ reads no more of that connection, and the kernel holds its peer up.
    # With 1 nobody who has a key gets in.
    zmq.RCVHWM: 2,
    # Who is cut off is heard to the end of what the kernel holds; Linux doubles it.
    zmq.RCVBUF: 2_048,
    # Every letter costs memory. A key exchange takes a few hundred bytes.
    zmq.MAXMSGSIZE: 1_024,
}
MAX_PORT = 65_535

Context = zmq.Context[zmq.Socket[bytes]]
Socket = zmq.Socket[bytes]
_TCP = re.compile(r"tcp://(?P<host>[^\s/]+):(?P<port>\d{1,5})")
_LOOPBACK = re.compile(r"(127\.\d+\.\d+\.\d+|localhost|\[::1\])")
# As numbers: to combine pyzmq's enums costs more than to send.
_MORE, _POLLIN = int(zmq.NOBLOCK | zmq.SNDMORE), int(zmq.POLLIN)
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
    """Return whether the address can be reached from, or reaches, another machine."""
    if address.startswith(("ipc://", "inproc://")):
        return False
    host = address.removeprefix("tcp://").rpartition(":")[0]
    return not address.startswith("tcp://") or _LOOPBACK.fullmatch(host) is None


def bind(
    context: Context,
    kind: int,
    address: str,
    gate: "Authenticator | None" = None,
    limits: Mapping[int, int] = MappingProxyType({}),
) -> Socket:
    """Return a socket of `kind` bound to `address`; `gate` authenticates its peers.

    Raises AddressError.

    limits: socket options for what queues for each peer, where ours do not fit.
    """
    socket = _socket_for(context, kind, address)
    if kind == zmq.XPUB:
        limits = {**_FOR_SUBSCRIPTIONS, **limits}
    for option, value in limits.items():
        socket.setsockopt(option, value)
    if gate is not None:
        gate.guard(socket)
    try:
        with _own_file() if address.startswith("ipc://") else nullcontext():
            socket.bind(address)
    except zmq.ZMQError as error:
        socket.close(0)
        raise AddressError(f"cannot bind {address}: {_reason(error)}") from None
    return socket


@contextmanager
def _own_file() -> Iterator[None]:
    """Let the file of an ipc address be its user's alone, within a `with`.

    libzmq 4.3.5 ends the process where it cannot accept an ipc connection for want of a file
    descriptor (its ipc_listener.cpp), and whoever may connect can bring that about.
    """
    before = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(before)


def connect(context: Context, kind: int, address: str, keys: ClientKeys | None = None) -> Socket:
    """A socket of `kind` that connects to `address`, now or when it appears.

    keys: which make it talk to their peer alone, encrypted. Raises AddressError.
    """
    socket = _socket_for(context, kind, address, keys)
    try:
        socket.connect(address)
    except zmq.ZMQError as error:
        socket.close(0)
        raise AddressError(f"cannot connect to {address}: {_reason(error)}") from None
    return socket


def unconnected(context: Context, kind: int, keys: ClientKeys | None = None) -> Socket:
    """A socket of `kind` for `reconnect` to connect."""
    socket = context.socket(kind)
    if keys is not None:
        socket.setsockopt(zmq.CURVE_SECRETKEY, keys.own.secret)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, keys.own.public.key)
        socket.setsockopt(zmq.CURVE_SERVERKEY, keys.peer.key)
    socket.setsockopt(zmq.LINGER, LINGER_MS)
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_FRAMES)
    socket.setsockopt(zmq.RCVHWM, HIGH_WATER_FRAMES)
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, KEEPALIVE_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, KEEPALIVE_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, KEEPALIVE_PROBES)
    socket.setsockopt(zmq.TCP_MAXRT, STUCK_MS)
    socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
    # A little above what is decoded, so that an oversized message is counted, not only cut off.
    socket.setsockopt(zmq.MAXMSGSIZE, 4 * MAX_FRAME_BYTES)
    return socket


def reconnect(socket: Socket, old: str | None, new: str, answer_ns: int = 0) -> None:
    """Connect to `new` instead of `old`; the two may be the same.

    answer_ns: when to repeat a request to connect that nobody answers; 0: as the kernel does.

    ZeroMQ reconnects by itself, but not after a peer broke the protocol, as with a message
    above our size limit: then the connection is gone for good.
    """
    if old is not None:
        disconnect(socket, old)
    socket.setsockopt(zmq.IPV6, "[" in new)
    socket.setsockopt(zmq.CONNECT_TIMEOUT, answer_ns // 1_000_000)
    socket.connect(new)


def disconnect(socket: Socket, address: str) -> None:
    """Close the connection to `address`, or give up making it."""
    with suppress(zmq.ZMQError):  # it may know the address no more
        socket.disconnect(address)


def has_message(socket: Socket) -> bool:
    """Return whether a message waits, in all its parts."""
    return bool(cast(int, socket.getsockopt(zmq.EVENTS)) & _POLLIN)


def receive_all(socket: Socket, most: int = MAX_MESSAGES) -> Iterator[list[bytes]]:
    """Yield the messages that wait, without blocking; a message is its list of parts.

    At most `most` a call, so that a flood cannot keep a loop from its ticks.
    """
    for _ in range(most):
        # Asked first: mostly nothing waits, and an exception takes twice as long.
        if not has_message(socket):
            return
        yield socket.recv_multipart(zmq.NOBLOCK)


def receive_each(socket: Socket) -> Iterator[bytes]:
    """Yield messages of one part, as `receive_all` does; of one with several, each is a message.

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
        for part in parts[:-1]:
            socket.send(part, _MORE)
        socket.send(parts[-1], zmq.NOBLOCK)
    except zmq.Again:
        return False
    return True


def wait_readable(sockets: Sequence[Socket], timeout_ns: int) -> None:
    """Sleep until a socket may have something to read, or the time is over.

    ZeroMQ's own poll counts whole milliseconds, too coarse for a 1 kHz loop. Its descriptors
    are edge-triggered, and sending uses the edge up too: so each socket is asked first.
    """
    if timeout_ns > 0 and not any(has_message(socket) for socket in sockets):
        wait_drained(descriptors(sockets), timeout_ns)


def wait_drained(numbers: Sequence[int], timeout_ns: int) -> None:
    """Wait as `wait_readable`, for `descriptors` of sockets that were all read to their end since
    anything was sent on them, so that there is no need to ask them again.

    What was left on a socket nevertheless waits for the next message or the time's end.
    """
    if timeout_ns > 0:
        select.select(numbers, (), (), timeout_ns * 1e-9)


def descriptors(sockets: Sequence[Socket]) -> list[int]:
    """Return what to wait for each socket by; it stays the same as long as the socket."""
    return [cast(int, socket.getsockopt(zmq.FD)) for socket in sockets]


def _reason(error: zmq.ZMQError) -> str:
    number = error.errno or 0
    return zmq.strerror(number) + _HINTS.get(number, "")


def _socket_for(
    context: Context, kind: int, address: str, keys: ClientKeys | None = None
) -> Socket:
    match = _TCP.fullmatch(address)
    if match and int(match["port"]) > MAX_PORT:
        # ZeroMQ takes it modulo 65536.
        raise AddressError(f"{address}: there is no such port; the highest is {MAX_PORT}")
    socket = unconnected(context, kind, keys)
    socket.setsockopt(zmq.IPV6, "[" in address)
    return socket
