"""ZeroMQ sockets: addresses, keepalive, limits.

One address names a stream. Data is PUB to SUB there; control is ROUTER to DEALER one port
higher (for ipc: the path with ".control" appended). ZeroMQ reconnects by itself; the kernel's
keepalive closes the connection to a peer that is dead or unreachable.
"""

import errno
import ipaddress
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from socket import if_indextoname
from types import MappingProxyType
from typing import Any, Protocol, cast

import zmq

from protocol.errors import AddressError
from protocol.host.descriptors import DescriptorSet
from protocol.wire.messages import MAX_FRAME_BYTES

RECONNECT_MS, LINGER_MS = 20, 500
HIGH_WATER_FRAMES = 1_000
MAX_MESSAGES = 200
_OPTIONS: dict[int, int] = {
    zmq.LINGER: LINGER_MS,
    zmq.SNDHWM: HIGH_WATER_FRAMES,
    zmq.RCVHWM: HIGH_WATER_FRAMES,
    # The kernel probes silent peers. ZeroMQ's heartbeats would end the whole process when a peer
    # that has filled our queue disconnects (libzmq 4.3.5, its issues 3937 and 4364).
    zmq.TCP_KEEPALIVE: 1,
    zmq.TCP_KEEPALIVE_IDLE: 2,
    zmq.TCP_KEEPALIVE_INTVL: 2,
    zmq.TCP_KEEPALIVE_CNT: 4,
    # A peer that acknowledges nothing for 5 s, or has no room, has stopped reading. This is longer
    # than the 2 s after which a display replaces a silent connection.
    zmq.TCP_MAXRT: 5_000,
    zmq.RECONNECT_IVL: RECONNECT_MS,
    # Above the decoders' limit, so that oversized messages reach a decoder and are counted.
    zmq.MAXMSGSIZE: 4 * MAX_FRAME_BYTES,
}
# A publisher receives subscriptions only (protocol/security/budgets.py).
_FOR_SUBSCRIPTIONS: dict[int, int] = {
    # Report every subscription, also to a topic that another peer has subscribed to.
    zmq.XPUB_VERBOSE: 1,
    # While 2 subscriptions wait to be read, ZeroMQ reads no more of that connection, and TCP stops
    # its peer from sending. With a limit of 1, CURVE's handshake does not complete.
    zmq.RCVHWM: 2,
    # ZeroMQ reads the kernel's buffer to its end even after a connection is cut. Linux doubles it.
    zmq.RCVBUF: 2_048,
    # ZeroMQ stores every byte of a topic. CURVE's handshake needs a few hundred bytes.
    zmq.MAXMSGSIZE: 1_024,
}
MAX_PORT = 65_535

Context = zmq.Context[zmq.Socket[bytes]]
Socket = zmq.Socket[bytes]
_TCP = re.compile(r"tcp://(?P<host>[^\s/]+):(?P<port>\d{1,5})")
_LOOPBACK = re.compile(r"(127\.\d+\.\d+\.\d+|localhost|\[::1\])")
# Plain integers, since combining pyzmq's enums costs more than sending.
_MORE, _POLLIN = int(zmq.NOBLOCK | zmq.SNDMORE), int(zmq.POLLIN)
_HINTS = {
    zmq.EADDRINUSE: "; another program holds it",
    zmq.EADDRNOTAVAIL: "; this machine does not have it",
    errno.ENODEV: "; this machine does not have it",
}


class LinkSecurity(Protocol):
    """Security of one end of a link, set on its socket before that binds or connects.

    It is an `Authenticator` of the end that binds, and the `ClientKeys` of the end that connects.
    """

    def protect(self, socket: Socket, /) -> None:
        """Set the socket's options."""


def control_address(address: str) -> str:
    """Return the control address that belongs to a data address. Raises AddressError."""
    match = _TCP.fullmatch(address)
    if match and 0 < int(match["port"]) < MAX_PORT:
        return f"tcp://{match['host']}:{int(match['port']) + 1}"
    if address.startswith("ipc://") and len(address) > len("ipc://"):
        return address + ".control"
    raise AddressError(
        f"{address}: not an address; write tcp://HOST:PORT with a port of 1 to 65534, or ipc://PATH"
    )


def tcp_address(place: tuple[Any, ...], port: int | None = None) -> str:
    """Return the address of a place as `getaddrinfo` gives it, at its port or another one.

    An IPv6 address of one link alone keeps its interface.
    """
    host, own_port, *more = place
    if ":" not in host:
        return f"tcp://{host}:{port or own_port}"
    if more[1:] and more[1] and "%" not in host:
        host = f"{host}%{if_indextoname(more[1])}"
    return f"tcp://[{host}]:{port or own_port}"


def network_address(address: str) -> str:
    """Return an IP address without its interface, as `getpeername` gives it.

    Returns "" for what ipc gives instead (user and process).
    """
    address, _, _ = address.partition("%")
    with suppress(ValueError):
        ipaddress.ip_address(address)
        return address
    return ""


def beyond_loopback(address: str) -> bool:
    """Return whether an address leads to, or can be reached from, another machine."""
    if address.startswith(("ipc://", "inproc://")):
        return False
    host = address.removeprefix("tcp://").rpartition(":")[0]
    return not address.startswith("tcp://") or _LOOPBACK.fullmatch(host) is None


def bind(
    context: Context,
    kind: int,
    address: str,
    authenticator: LinkSecurity | None = None,
    limits: Mapping[int, int] = MappingProxyType({}),
) -> Socket:
    """Return a socket of `kind` bound to a tcp:// or ipc:// `address`. Raises AddressError.

    An XPUB socket gets options for `SubscriptionBudget`. authenticator: the `Authenticator` of the
    peers. limits: options for the queue of each peer that replace the default ones.
    """
    socket = _socket_for(context, kind, address)
    if kind == zmq.XPUB:
        limits = {**_FOR_SUBSCRIPTIONS, **limits}
    for option, value in limits.items():
        socket.setsockopt(option, value)
    if authenticator is not None:
        authenticator.protect(socket)
    # Only the same user may open the file of an ipc address. libzmq 4.3.5 aborts the process if it
    # has no descriptor for an ipc connection (ipc_listener.cpp), which other users could cause.
    mask = os.umask(0o077)
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        socket.close(0)
        raise AddressError(f"cannot bind {address}: {_reason(error)}") from None
    finally:
        os.umask(mask)
    return socket


def connect(
    context: Context,
    kind: int,
    address: str,
    keys: LinkSecurity | None = None,
    watch: Callable[[Socket], object] | None = None,
) -> Socket:
    """Return a socket of `kind` that connects to `address`, now or when it appears.

    With `keys` (`ClientKeys`) the connection is encrypted, and only the holder of the peer's key
    can answer. watch: called with the socket before it connects. Raises AddressError.
    """
    socket = _socket_for(context, kind, address, keys)
    if watch is not None:
        watch(socket)
    try:
        socket.connect(address)
    except zmq.ZMQError as error:
        socket.close(0)
        raise AddressError(f"cannot connect to {address}: {_reason(error)}") from None
    return socket


def unconnected(context: Context, kind: int, keys: LinkSecurity | None = None) -> Socket:
    """Return a socket of `kind` without an address, for `reconnect`; keys: as of `connect`."""
    socket = context.socket(kind)
    if keys is not None:
        keys.protect(socket)
    for option, value in _OPTIONS.items():
        socket.setsockopt(option, value)
    return socket


def reconnect(socket: Socket, old: str | None, new: str, answer_ns: int = 0) -> None:
    """Connect a socket from `unconnected` to `new`, and disconnect it from `old`, if given.

    Both may be the same address. ZeroMQ reconnects by itself, but not after a peer broke the
    protocol, for example by a message above the size limit. A request to connect that is not
    answered within `answer_ns` is repeated; 0: as the kernel does.
    """
    if old is not None:
        disconnect(socket, old)
    socket.setsockopt(zmq.IPV6, "[" in new)
    socket.setsockopt(zmq.CONNECT_TIMEOUT, answer_ns // 1_000_000)
    socket.connect(new)


def disconnect(socket: Socket, address: str) -> None:
    """Close the connection to `address`, or stop connecting."""
    with suppress(zmq.ZMQError):  # it may be disconnected already
        socket.disconnect(address)


def has_message(socket: Socket) -> bool:
    """Return whether a whole message waits."""
    return bool(cast(int, socket.getsockopt(zmq.EVENTS)) & _POLLIN)


def receive_multipart(socket: Socket, most: int = MAX_MESSAGES) -> Iterator[list[bytes]]:
    """Yield up to `most` waiting messages without blocking; a message is its list of parts.

    The bound ensures that a flood cannot delay a loop's ticks.
    """
    for _ in range(most):
        # Usually nothing waits, and an exception would take twice as long as this check.
        if not has_message(socket):
            return
        yield socket.recv_multipart(zmq.NOBLOCK)


def receive_parts(socket: Socket) -> Iterator[bytes]:
    """Yield the parts of waiting messages, one after the other.

    Frames have one part: this is the quickest way to receive them, with one call for each.
    """
    for _ in range(MAX_MESSAGES):
        try:
            message = socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return
        yield message
        # Frames usually come one by one, and an exception takes twice as long as this check.
        if not has_message(socket):
            return


def send(socket: Socket, *parts: bytes) -> bool:
    """Send a message without blocking; return False if the peer cannot take it now."""
    try:
        for part in parts[:-1]:
            socket.send(part, _MORE)
        socket.send(parts[-1], zmq.NOBLOCK)
    except zmq.Again:
        return False
    return True


def wait_readable(sockets: Sequence[Socket], timeout_ns: int) -> None:
    """Wait until a socket may be readable, or for `timeout_ns`.

    ZeroMQ's own poll counts whole milliseconds, which is too coarse for a 1 kHz loop. Its
    descriptors are edge-triggered, and sending consumes the edge too, so each socket is checked
    first.
    """
    if timeout_ns > 0 and not any(has_message(socket) for socket in sockets):
        wait_on_descriptors(descriptors(sockets), timeout_ns)


def wait_on_descriptors(waited_for: DescriptorSet, timeout_ns: int) -> bool:
    """Wait as `wait_readable` does, for `descriptors` of sockets that were read completely.

    All must have been read since the last send. A message that is left does not end the wait.
    Return False if nothing has arrived.
    """
    return timeout_ns <= 0 or waited_for.wait(timeout_ns)


def descriptors(sockets: Iterable[Socket]) -> DescriptorSet:
    """Return the descriptors to wait for, which do not change during a socket's life."""
    return DescriptorSet([cast(int, socket.getsockopt(zmq.FD)) for socket in sockets])


def _reason(error: zmq.ZMQError) -> str:
    number = error.errno or 0
    return zmq.strerror(number) + _HINTS.get(number, "")


def _socket_for(
    context: Context, kind: int, address: str, keys: LinkSecurity | None = None
) -> Socket:
    match = _TCP.fullmatch(address)
    if match and int(match["port"]) > MAX_PORT:
        # ZeroMQ would take the port modulo 65536.
        raise AddressError(f"{address}: there is no such port; the highest is {MAX_PORT}")
    socket = unconnected(context, kind, keys)
    socket.setsockopt(zmq.IPV6, "[" in address)
    return socket
