"""Client of a display's telemetry: one socket, kept connected, and its decoded messages."""

from collections.abc import Iterator

import zmq

from protocol import sockets
from protocol.provenance import PROVENANCE
from protocol.security.keys import ClientKeys
from protocol.security.socket_monitor import HandshakeMonitor
from protocol.wire.status import STATUS
from protocol.wire.telemetry import HEARD, TRACE
from telepulse.telemetry.decoder import Entry, TelemetryDecoder

# ZeroMQ does not retry after a refusal, but the key may be allowed later.
RECONNECT_AFTER_NS = 2_000_000_000


class TelemetryClient:
    """Client of all that a display publishes.

    Attributes
    ----------
    decoder : TelemetryDecoder
        State of the telemetry so far, and counts of what was missed.
    """

    def __init__(self, address: str, keys: ClientKeys | None) -> None:
        """Connect. Raises AddressError."""
        self._address = address
        self._context: sockets.Context = zmq.Context()
        try:
            self._socket = sockets.connect(self._context, zmq.SUB, address, keys)
        except BaseException:
            self._context.destroy(linger=0)
            raise
        self._handshakes = HandshakeMonitor(self._context, keys)
        self._handshakes.watch(self._socket)
        self._refused = 0
        self._reconnect_ns: int | None = None
        self.decoder = TelemetryDecoder()

    def subscribe(self) -> None:
        """Subscribe to all topics; a display that waits for its recorder begins then."""
        for topic in (PROVENANCE, TRACE, STATUS, HEARD):
            self._socket.subscribe(topic)

    def messages(self) -> Iterator[list[Entry]]:
        """Yield the entries of each waiting message; an empty list for one without any."""
        for message in sockets.receive_all(self._socket):
            self._reconnect_ns = None
            yield self.decoder.decode(*message) if len(message) == 2 else []

    def poll(self, now_ns: int) -> None:
        """Count refusals, and connect again some time after one; call it often."""
        self._handshakes.poll(now_ns)
        refused = self._handshakes.rejected.total()
        if refused > self._refused and self._reconnect_ns is None:
            self._reconnect_ns = now_ns + RECONNECT_AFTER_NS
        self._refused = refused
        if self._reconnect_ns is not None and now_ns >= self._reconnect_ns:
            self._reconnect_ns = None
            sockets.reconnect(self._socket, self._address, self._address)

    def wait(self, timeout_ns: int) -> None:
        """Sleep until a message may have arrived, or for `timeout_ns`."""
        sockets.wait_readable([self._socket], timeout_ns)

    def close(self) -> None:
        """Close the socket."""
        self._context.destroy(linger=0)
