"""Client of a display's telemetry: one socket, kept connected, and its decoded messages."""

import logging
import math
import os
import secrets
import time
from collections.abc import Iterator, Sequence

import zmq

from protocol import sockets
from protocol.provenance import PROVENANCE
from protocol.security.handshakes import HandshakeMonitor
from protocol.security.link_keys import ClientKeys
from protocol.wire.marks import MARK, Mark, MarkRequest, pack_request
from protocol.wire.telemetry import CAPTURE, STATUS, TRACE
from telepulse.telemetry.decoder import Entry, TelemetryDecoder

logger = logging.getLogger(__name__)

# ZeroMQ does not retry after a refusal, but the key may be allowed later.
RECONNECT_AFTER_NS = 2_000_000_000
POLL_EVERY_NS = 100_000_000
ALL_TOPICS = PROVENANCE, TRACE, STATUS, MARK, CAPTURE


class TelemetryClient:
    """Client of everything that a display publishes, which can request marks.

    names: of the reader and of what becomes of the telemetry, as `TelemetryDecoder` takes them.
    decoder: has the state of the telemetry and counts of missed messages. Raises AddressError.
    """

    def __init__(
        self,
        address: str,
        keys: ClientKeys | None,
        names: tuple[str, str] = ("the recorder", "the recording"),
    ) -> None:
        self._address = address
        self._context: sockets.Context = zmq.Context()
        self._handshakes = HandshakeMonitor(self._context, keys)
        try:
            self._socket = sockets.connect(
                *(self._context, zmq.XSUB, address, keys),
                watch=lambda socket: self._handshakes.watch([socket], lambda: address),
            )
        except BaseException:
            self._context.destroy(linger=0)
            raise
        self._refused = 0
        self._reconnect_ns: int | None = None
        self._stopping = False
        self._local = not sockets.beyond_loopback(address)
        # Time of arrival of the newest message.
        self._arrived_ns = 0
        self._requested: dict[int, str] = {}
        self.decoder = TelemetryDecoder(*names)

    def subscribe(self, topics: Sequence[bytes] = ALL_TOPICS) -> None:
        """Subscribe to topics; a display that waits for its recorder continues at the last one."""
        for topic in topics:
            self._socket.send(b"\1" + topic)

    def mark(self, text: str, age_ns: int = 0) -> None:
        """Request a mark at the instant `age_ns` ago; an empty text becomes a number.

        The clock of a display on another machine is known from its telemetry, and late by the
        transit of a message.
        """
        now_ns, at_ns = time.perf_counter_ns(), None
        if self._local:
            at_ns = now_ns - age_ns
        elif self.decoder.started:
            at_ns = self.decoder.now_ns + now_ns - self._arrived_ns - age_ns
        request = MarkRequest(secrets.randbits(62), at_ns, text)
        self._requested[request.id] = text
        sockets.send(self._socket, pack_request(request))

    @property
    def unmarked(self) -> list[str]:
        """Texts of requested marks that the display has not published."""
        return list(self._requested.values())

    def messages(self) -> Iterator[list[Entry]]:
        """Yield the entries of each waiting message; an empty list for one without any."""
        for message in sockets.receive_multipart(self._socket):
            self._reconnect_ns, self._arrived_ns = None, time.perf_counter_ns()
            yield self.decoder.decode(*message) if len(message) == 2 else []
            if (mark := self.decoder.last_mark) is not None:
                self._requested.pop(mark.id, None)

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

    def follow(
        self,
        name: str,
        seconds: float | None = None,
        silence_s: float | None = None,
        display_pid: int | None = None,
    ) -> Iterator[list[Entry]]:
        """Yield the entries of each message until the display ends, and an empty list in between.

        It also ends after `seconds`, or after `silence_s` without a message. name: of the reader,
        for the warning that it ended after silence. display_pid: process of the display, if it
        started this process. Its first message comes only after its drive has homed: before that,
        silence counts only once the display has ended.
        """
        begin_ns = received_ns = time.perf_counter_ns()
        longest_ns, silent_ns = (
            math.inf if given_s is None else given_s * 1e9 for given_s in (seconds, silence_s)
        )
        while not (self._stopping or self.decoder.ended):
            now_ns = time.perf_counter_ns()
            if not self.decoder.started and os.getppid() == display_pid:
                received_ns = now_ns
            for entries in self.messages():
                received_ns = now_ns
                yield entries
            silent = now_ns - received_ns > silent_ns
            if silent:
                logger.warning(f"{name}: ended, nothing came for {silence_s:g} s")
            if silent or now_ns - begin_ns > longest_ns:
                return
            self.poll(now_ns)
            yield []
            sockets.wait_readable([self._socket], POLL_EVERY_NS)

    def stop(self) -> None:
        """End `follow` after the present message; safe in a signal handler."""
        self._stopping = True

    def close(self) -> None:
        """Close the socket."""
        self._context.destroy(linger=0)


def await_mark(address: str, keys: ClientKeys | None, text: str, within_s: float) -> Mark | None:
    """Mark the present time of a display; return its mark, or None if none comes in time.

    Raises AddressError.
    """
    client = TelemetryClient(address, keys)
    try:
        client.subscribe([MARK])
        client.mark(text)
        for _ in client.follow(address, within_s):
            if not client.unmarked:
                return client.decoder.last_mark
        return None
    finally:
        client.close()
