"""Traces, statuses, marks and, on request, copies of received messages, over one socket."""

import time
from collections import Counter

import zmq

from protocol import sockets
from protocol.errors import WireError
from protocol.provenance import PROVENANCE
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.wire.marks import MARK, REQUEST, Mark, pack_mark, read_request
from protocol.wire.telemetry import (
    CAPTURE,
    STATUS,
    STATUS_TRACES,
    TRACE,
    CaptureWriter,
    TraceWriter,
)

LOOK_EVERY_S = 0.01
# A request for a mark may have waited for its connection; an older one is refused.
OLDEST_NS = 60_000_000_000
# A reader on the same machine reads its clock after the display has read its own.
NEWEST_NS = 1_000_000_000


class MarkCounter:
    """Marks of a display's run: checks requests and numbers them. Pure.

    published: number of marks. rejected: number of requests that are malformed or not of the last
    minute.
    """

    def __init__(self) -> None:
        self.published = 0
        self.rejected: Counter[str] = Counter()

    def take(self, data: bytes, now_ns: int) -> Mark | None:
        """Return the mark that a request asks for at `now_ns`, or None where it is refused."""
        try:
            request = read_request(data)
        except WireError:
            self.rejected["mark"] += 1
            return None
        at_ns = now_ns if request.at_ns is None else request.at_ns
        if not now_ns - OLDEST_NS <= at_ns <= now_ns + NEWEST_NS:
            self.rejected["mark"] += 1
            return None
        self.published += 1
        text = request.text or f"mark {self.published}"
        return Mark(self.published, request.id, min(at_ns, now_ns), text)


class Publisher:
    """Publisher of a display's telemetry over one bound XPUB socket.

    run: random number of this run of the display. authenticator: of the readers. provenance: sent
    to readers that request it. trace: of the ticks that are not published yet.
    """

    def __init__(
        self,
        socket: sockets.Socket,
        run: int,
        authenticator: Authenticator | None = None,
        provenance: bytes = b"",
    ) -> None:
        self._socket, self._authenticator = socket, authenticator
        topics = (TRACE, STATUS, MARK, CAPTURE, PROVENANCE)
        self._subscriptions = SubscriptionBudget(socket, topics, REQUEST)
        self._provenance = provenance
        self._marks = MarkCounter()
        self.trace = TraceWriter()
        self.captured = CaptureWriter(run)
        self.address = socket.getsockopt_string(zmq.LAST_ENDPOINT)

    @property
    def rejected(self) -> Counter[str]:
        """Numbers of refused readers, and of their subscriptions and marks, by cause."""
        rejected = self._subscriptions.rejected + self._marks.rejected
        return rejected if self._authenticator is None else rejected + self._authenticator.rejected

    def publish(self) -> bool:
        """Publish the ticks since the last trace; return whether a status is due."""
        self._publish_captured()
        trace = self.trace.rest()
        if trace is None:
            return False
        sockets.send(self._socket, TRACE, trace)
        self.captured.traces_published += 1
        return self.captured.traces_published % STATUS_TRACES == 0

    def status(self, status: bytes) -> None:
        """Publish a status."""
        sockets.send(self._socket, STATUS, status)
        self.captured.statuses_published += 1

    def finish(self, status: bytes) -> None:
        """Publish the remaining ticks and messages, and the last status."""
        self.publish()
        self._publish_captured()
        self.status(status)

    def await_recorder(self, seconds: float) -> bool:
        """Wait for a reader that requests captured messages; return False if none does in time."""
        until_s = time.monotonic() + seconds
        while not self.captured.wanted and time.monotonic() < until_s:
            self._serve_readers()
            time.sleep(LOOK_EVERY_S)
        return self.captured.wanted

    def _publish_captured(self) -> None:
        self._serve_readers()
        if self.captured.wanted:
            for message in self.captured.take(time.perf_counter_ns(), time.time_ns()):
                sockets.send(self._socket, CAPTURE, message)

    def _serve_readers(self) -> None:
        if self._authenticator is not None:
            self._authenticator.poll(time.perf_counter_ns())
        for message in self._subscriptions.receive():
            if message.startswith(REQUEST):
                mark = self._marks.take(message, time.perf_counter_ns())
                if mark is not None:
                    sockets.send(self._socket, MARK, pack_mark(mark))
                continue
            self.captured.follow(message)
            if message == b"\1" + PROVENANCE and self._provenance:
                sockets.send(self._socket, PROVENANCE, self._provenance)
