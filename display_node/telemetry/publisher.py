"""Traces, statuses and, on request, copies of received messages of a display, over one socket."""

import time

import zmq

from protocol import sockets
from protocol.provenance import PROVENANCE
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.ticks import TickState
from protocol.wire.telemetry import (
    CAPTURE,
    STATUS,
    STATUS_TRACES,
    TRACE,
    CaptureWriter,
    TraceWriter,
)

LOOK_EVERY_S = 0.01


class Publisher:
    """Publisher of a display's telemetry over one bound XPUB socket.

    run: random number of this run of the display. authenticator: of the readers. provenance: sent
    to readers that request it. rejected: number of refused subscriptions by cause.
    """

    def __init__(
        self,
        socket: sockets.Socket,
        run: int,
        authenticator: Authenticator | None = None,
        provenance: bytes = b"",
    ) -> None:
        self._socket, self._authenticator = socket, authenticator
        self._subscriptions = SubscriptionBudget(socket, (TRACE, STATUS, CAPTURE, PROVENANCE))
        self._provenance = provenance
        self.rejected = self._subscriptions.rejected
        self._trace = TraceWriter()
        self.captured = CaptureWriter(run)
        self.address = socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def add(self, *states: TickState) -> bool:
        """Add a tick, of which each contactor has a state; return whether a status is due."""
        trace = self._trace.add(*states)
        if trace is None:
            return False
        self._publish_trace(trace)
        return self.captured.traces_published % STATUS_TRACES == 0

    def status(self, status: bytes) -> None:
        """Publish a status."""
        sockets.send(self._socket, STATUS, status)
        self.captured.statuses_published += 1

    def finish(self, status: bytes) -> None:
        """Publish the remaining ticks and messages, and the last status."""
        rest = self._trace.rest()
        if rest is not None:
            self._publish_trace(rest)
        self._publish_captured()
        self.status(status)

    def await_recorder(self, seconds: float) -> bool:
        """Wait for a reader that requests captured messages; return False if none does in time."""
        until_s = time.monotonic() + seconds
        while not self.captured.wanted and time.monotonic() < until_s:
            self._serve_readers()
            time.sleep(LOOK_EVERY_S)
        return self.captured.wanted

    def _publish_trace(self, trace: bytes) -> None:
        self._publish_captured()
        sockets.send(self._socket, TRACE, trace)
        self.captured.traces_published += 1

    def _publish_captured(self) -> None:
        self._serve_readers()
        if self.captured.wanted:
            for message in self.captured.take(time.perf_counter_ns(), time.time_ns()):
                sockets.send(self._socket, CAPTURE, message)

    def _serve_readers(self) -> None:
        if self._authenticator is not None:
            self._authenticator.poll(time.perf_counter_ns())
        for subscription in self._subscriptions.receive():
            self.captured.follow(subscription)
            if subscription == b"\1" + PROVENANCE and self._provenance:
                sockets.send(self._socket, PROVENANCE, self._provenance)
