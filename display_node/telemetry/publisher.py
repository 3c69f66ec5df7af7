"""Traces, statuses, marks and, on request, copies of received messages, over one socket."""

import logging
import time
from collections import Counter

import zmq

from protocol import sockets
from protocol.errors import WireError
from protocol.faults import Note, Part
from protocol.provenance import PROVENANCE
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.wire.marks import MARK, REQUEST, Mark, pack_mark, read_request
from protocol.wire.telemetry import (
    CAPTURE,
    RECORDER,
    STATUS,
    STATUS_TRACES,
    TRACE,
    CaptureWriter,
    TraceWriter,
)

logger = logging.getLogger(__name__)

LOOK_EVERY_S = 0.01
# A request for a mark may have waited for its connection; an older one is refused.
OLDEST_NS = 60_000_000_000
# A reader on the same machine reads its clock after the display has read its own.
NEWEST_NS = 1_000_000_000
RECORDER_GONE = (
    "it is gone, the rest of this run is not recorded; telepulse record begins another recording"
)


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
    to readers that request it. trace: of the ticks that are not published yet. notes: what is wrong
    with the display's recorder.
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
        # Topic of the recorder that the display has started; None without one.
        self._recorder: bytes | None = None
        self._recording = False
        self.notes: list[Note] = []
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
        # From here on the recorder may end.
        self._recorder = None
        self.publish()
        self._publish_captured()
        self.status(status)

    def await_recorder(self, seconds: float, name: str | None = None) -> bool:
        """Wait for the recorder of this name, or without one for any; return whether it reads.

        A recorder requests captured messages. If the one of `name` ends during the run, that is a
        note.
        """
        if name is not None:
            self._recorder = RECORDER + name.encode()
            self._subscriptions.accept(self._recorder)
        until_s = time.monotonic() + seconds
        while not self._is_recorded and time.monotonic() < until_s:
            self._serve_readers()
            time.sleep(LOOK_EVERY_S)
        return self._is_recorded

    @property
    def _is_recorded(self) -> bool:
        return self.captured.wanted if self._recorder is None else self._recording

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
            if message[1:] == self._recorder:
                self._follow_recorder(message[:1] == b"\1")
            if message == b"\1" + PROVENANCE and self._provenance:
                sockets.send(self._socket, PROVENANCE, self._provenance)

    def _follow_recorder(self, recording: bool) -> None:
        """Note that the display's recorder has subscribed, also again, or is gone."""
        self._recording = recording
        if recording:
            self.notes = []
        else:
            self.notes = [Note(Part.RECORDER, RECORDER_GONE)]
            logger.error(f"recorder: {RECORDER_GONE}")
