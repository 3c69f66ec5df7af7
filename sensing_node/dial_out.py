"""Dial-out: a process beside a sensing node that opens its connections from within, to a relay."""

import json
import logging
import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zmq

from protocol import sockets, tunnel
from protocol.errors import WireError
from protocol.host.child_process import Sidecar, run_as_sidecar
from protocol.host.process import freeze_objects, raise_file_limit
from protocol.security.keys import ClientKeys, read_pair, read_public
from protocol.security.socket_monitor import HandshakeMonitor
from protocol.tunnel import TunnelEnd, Tunnels

logger = logging.getLogger(__name__)

LOOPBACK = {"": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}
WAIT_NS = 250_000_000
# Time after the node's end in which the tunnels still carry its last messages.
ENDS_WITHIN_S = 3.0


@contextmanager
def start_dial_out(
    relay: str | None, bound: str, key: Path | None, peer: Path | None
) -> Iterator[None]:
    """Open connections to `relay` for the node bound to `bound`, within a `with`.

    key, peer: this node's key and the relay's public key; None without keys. Does nothing without
    a relay. Raises AddressError, and SidecarError where the process cannot start.
    """
    if relay is None:
        yield
        return
    node = {"relay": relay, "key": key and str(key), "peer": peer and str(peer)}
    host, port = tunnel.host_and_port(bound)
    tunnel.host_and_port(relay)
    node |= {"host": LOOPBACK.get(host, host), "port": str(port)}
    with Sidecar("dial-out", "sensing_node.dial_out", json.dumps(node)):
        yield


class DialOut:
    """Registration at a relay, and the connections that it requests.

    relay: address of the relay's registration. place: host and port of the node's data socket.
    """

    def __init__(self, relay: str, place: tuple[str, int], keys: ClientKeys | None) -> None:
        self._relay, self._place = relay, place
        self._tunnels = Tunnels()
        self._context: sockets.Context = zmq.Context()
        self._registry = sockets.unconnected(self._context, zmq.DEALER, keys)
        self._monitor = HandshakeMonitor(self._context, keys)
        self._monitor.watch(self._registry)
        # As `getaddrinfo` gives it.
        self._connected: tuple[Any, ...] | None = None
        self._state = b""
        self._next_ns = self._answered_ns = 0
        self._ends_s = float("inf")

    def run(self) -> None:
        """Serve until the node has ended and its last messages have passed."""
        self._tunnels.call(sys.stdin.fileno(), self._read_input)
        (descriptor,) = sockets.descriptors([self._registry])
        self._tunnels.call(descriptor, lambda: None)
        while time.monotonic() < self._ends_s:
            self._poll(now_ns := time.perf_counter_ns())
            self._tunnels.run(0 if sockets.has_message(self._registry) else now_ns + WAIT_NS)
            if self._ends_s < float("inf") and not self._tunnels.open:
                break
        self._tunnels.shut()
        self._context.destroy(linger=sockets.LINGER_MS)

    def _read_input(self) -> None:
        """Begin to end where the node has closed the pipe by its own end; it sends nothing."""
        if os.read(sys.stdin.fileno(), 1) or self._ends_s < float("inf"):
            return
        self._tunnels.forget(sys.stdin.fileno())
        self._ends_s = time.monotonic() + ENDS_WITHIN_S
        sockets.send(self._registry, tunnel.END)

    def _poll(self, now_ns: int) -> None:
        self._monitor.poll(now_ns)
        for message in sockets.receive_parts(self._registry):
            self._answered_ns = now_ns
            if message in (tunnel.REGISTERED, tunnel.TAKEN):
                self._report(message)
                continue
            try:
                self._open(*tunnel.decode_open(message))
            except (WireError, OSError) as error:
                logger.warning(f"no tunnel was opened: {error}")
        if now_ns < self._next_ns or self._ends_s < float("inf"):
            return
        self._next_ns = now_ns + tunnel.REGISTER_EVERY_NS
        if self._connected is None or now_ns - self._answered_ns > tunnel.SILENT_NS:
            self._report(b"")
            self._connect(now_ns)
        sockets.send(self._registry, tunnel.REGISTER)

    def _connect(self, now_ns: int) -> None:
        """Connect anew to the relay, whose name may have another address by now."""
        self._answered_ns = now_ns
        host, port = tunnel.host_and_port(self._relay)
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][4]
        except OSError as error:
            logger.warning(f"{host} is not found: {error.strerror}; retrying")
            return
        before, self._connected = self._connected, found
        old = None if before is None else sockets.tcp_address(before)
        sockets.reconnect(self._registry, old, sockets.tcp_address(found))

    def _report(self, state: bytes) -> None:
        if state == self._state:
            return
        if state == tunnel.REGISTERED:
            logger.info(f"registered at {self._relay}")
        elif state == tunnel.TAKEN:
            logger.warning(f"{self._relay} serves another sensing node; waiting for its place")
        elif self._state:
            logger.warning(f"{self._relay} does not answer; registering again")
        self._state = state

    def _open(self, channel: int, token: bytes) -> None:
        """Open a connection to the relay; join it to the node once a display's bytes arrive."""
        assert self._connected is not None
        host, port, *scope = self._connected
        outer = TunnelEnd(tunnel.dial((host, port + 1, *scope)))
        outer.pending = token
        self._tunnels.add(outer, lambda: self._join(outer, channel))

    def _join(self, outer: TunnelEnd, channel: int) -> None:
        try:
            received = outer.connection.recv(tunnel.CHUNK_BYTES)
        except OSError:
            received = b""
        if not received:
            self._tunnels.close(outer)
            return
        host, port = self._place
        self._tunnels.join(outer, TunnelEnd(tunnel.dial((host, port + channel))), received)


def main() -> None:
    """Dial out for the node that has started this process, until it ends."""
    node = json.loads(sys.argv[1])
    # Samples pass through here, so it keeps the node's priority.
    with run_as_sidecar(niceness=0) as ready:
        raise_file_limit()
        keys = None
        if node["key"] is not None:
            keys = ClientKeys(read_pair(Path(node["key"])), read_public(Path(node["peer"])))
        dial_out = DialOut(node["relay"], (node["host"], int(node["port"])), keys)
        ready(node["relay"])
    freeze_objects()
    dial_out.run()


if __name__ == "__main__":
    main()
