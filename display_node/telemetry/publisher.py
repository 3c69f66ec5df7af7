"""The telemetry's socket: publishes traces, statuses and, to who asks, what was heard."""

import time

import zmq

from protocol import sockets
from protocol.provenance import PROVENANCE
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.wire.telemetry import (
    HEARD,
    STATUS,
    STATUS_TRACES,
    TRACE,
    CaptureWriter,
    TickState,
    TraceWriter,
)

LOOK_EVERY_S = 0.01
ASKED = b"\1" + PROVENANCE


class Publisher:
    """The publications of a display, over one bound XPUB socket.

    rejected: what its readers were refused, by cause.
    """

    def __init__(
        self,
        socket: sockets.Socket,
        run: int,
        gate: Authenticator | None = None,
        provenance: bytes = b"",
    ) -> None:
        """Publish on a bound socket.

        run: a random number of this run of the display. gate: authenticator of readers. provenance:
        is sent to readers that request it.
        """
        self._socket = socket
        self._gate = gate
        self._subscribers = SubscriptionBudget(socket, (TRACE, STATUS, HEARD, PROVENANCE))
        self._provenance = provenance
        self.rejected = self._subscribers.rejected
        self._trace = TraceWriter()
        self.heard = CaptureWriter(run)
        self.address = socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def add(self, felt: TickState) -> bool:
        """Add a tick; return whether a status is due."""
        trace = self._trace.add(felt)
        if trace is None:
            return False
        self._publish_trace(trace)
        return self.heard.traces % STATUS_TRACES == 0

    def status(self, status: bytes) -> None:
        """Publish a status."""
        sockets.send(self._socket, STATUS, status)
        self.heard.statuses += 1

    def finish(self, status: bytes) -> None:
        """Publish what is left, and the last status."""
        rest = self._trace.rest()
        if rest is not None:
            self._publish_trace(rest)
        self._publish_heard()
        self.status(status)

    def await_recorder(self, seconds: float) -> bool:
        """Wait for a reader that asks for what was heard; False when none came in time."""
        until_s = time.monotonic() + seconds
        while not self.heard.wanted and time.monotonic() < until_s:
            self._follow_readers()
            time.sleep(LOOK_EVERY_S)
        return self.heard.wanted

    def _publish_trace(self, trace: bytes) -> None:
        self._publish_heard()
        sockets.send(self._socket, TRACE, trace)
        self.heard.traces += 1

    def _publish_heard(self) -> None:
        self._follow_readers()
        if self.heard.wanted:
            for message in self.heard.take(time.monotonic_ns(), time.time_ns()):
                sockets.send(self._socket, HEARD, message)

    def _follow_readers(self) -> None:
        if self._gate is not None:
            self._gate.poll(time.monotonic_ns())
        for subscription in self._subscribers.receive():
            self.heard.follow(subscription)
            if subscription == ASKED and self._provenance:
                sockets.send(self._socket, PROVENANCE, self._provenance)
