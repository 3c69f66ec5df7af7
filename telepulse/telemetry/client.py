"""A display's telemetry as it comes: one socket, kept connected, and what it says."""

from collections.abc import Callable, Iterator

import zmq

from protocol import sockets
from protocol.provenance import PROVENANCE
from protocol.security.keys import ClientKeys
from protocol.security.socket_monitor import HandshakeMonitor
from protocol.wire.status import STATUS
from protocol.wire.telemetry import HEARD, TRACE
from telepulse.telemetry.transcript import Entry, Transcript

# ZeroMQ tries no more once it was refused; the key may be allowed later.
AGAIN_AFTER_NS = 2_000_000_000


class TelemetryReader:
    """Reads all that a display publishes.

    transcript: what was said so far, and what of it never came.
    """

    def __init__(self, address: str, keys: ClientKeys | None, warn: Callable[[str], None]) -> None:
        """warn is told once why a connection does not come about. Raises AddressError."""
        self._address = address
        self._context: sockets.Context = zmq.Context()
        try:
            self._socket = sockets.connect(self._context, zmq.SUB, address, keys)
        except BaseException:
            self._context.destroy(linger=0)
            raise
        self._refusals = HandshakeMonitor(self._context, keys, warn)
        self._refusals.watch(self._socket)
        self._refused = 0
        self._again_ns: int | None = None
        self.transcript = Transcript()

    def listen(self) -> None:
        """Ask for all of it; a display that waits for its recorder begins."""
        for topic in (PROVENANCE, TRACE, STATUS, HEARD):
            self._socket.subscribe(topic)

    def messages(self) -> Iterator[list[Entry]]:
        """The entries of each message that waits; an empty list for one that tells nothing."""
        for message in sockets.receive_all(self._socket):
            self._again_ns = None
            yield self.transcript.take(*message) if len(message) == 2 else []

    def tend(self, now_ns: int) -> None:
        """Hear of refusals, and connect again some time after one; call it often."""
        self._refusals.poll(now_ns)
        refused = self._refusals.rejected.total()
        if refused > self._refused and self._again_ns is None:
            self._again_ns = now_ns + AGAIN_AFTER_NS
        self._refused = refused
        if self._again_ns is not None and now_ns >= self._again_ns:
            self._again_ns = None
            sockets.reconnect(self._socket, self._address, self._address)

    def wait(self, timeout_ns: int) -> None:
        """Sleep until a message may have come, or the time is over."""
        sockets.wait_readable([self._socket], timeout_ns)

    def close(self) -> None:
        """Let go of the socket."""
        self._context.destroy(linger=0)
