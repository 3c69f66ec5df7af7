"""A display's telemetry without a display, published over a real socket."""

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
import zmq

from display_node.telemetry.publisher import Publisher
from protocol import sockets
from protocol.security.authenticator import Authenticator
from protocol.security.link_keys import ServerKeys
from protocol.summary.fields import Summary
from protocol.ticks import TickBlock, TickState
from protocol.wire.messages import Bye, ClockReply, Frame, Welcome, encode_control, encode_frame
from protocol.wire.telemetry import (
    CAPTURE,
    CONTROL,
    STATUS,
    SUBSCRIBED,
    TRACE,
    CaptureWriter,
    PlaybackStatus,
    pack_status,
)
from telepulse.telemetry.decoder import Entry, TelemetryDecoder
from tests.support.streams import description
from tests.support.tick_blocks import TRACE_TICKS, packed_trace

SESSION = 7
MS = 1_000_000
BATCH = 5
Message = tuple[bytes, bytes]
QUEUE = 100
WALL_NS = 1_700_000_000_000_000_000
NOW_NS = 50_000_000_000
PLAYING = PlaybackStatus("finger", 0, 1.0, -4.8e-6, "linear", 60_000_000)
WELCOME = encode_control(Welcome(SESSION, 0, description()))


class TelemetryPublisher:
    """Publisher of ticks of 1 ms and of numbered frames of five samples, as fast as required."""

    def __init__(
        self, context: sockets.Context, address: str, keys: ServerKeys | None = None
    ) -> None:
        socket = sockets.unconnected(context, zmq.XPUB)
        # The queue is short, so that a test can fill it.
        socket.setsockopt(zmq.SNDHWM, QUEUE)
        socket.setsockopt(zmq.SNDBUF, 8_192)
        self.authenticator = None if keys is None else Authenticator(context, keys)
        if self.authenticator is not None:
            self.authenticator.protect(socket)
        socket.bind(address)
        self.publisher = Publisher(socket, run=1, authenticator=self.authenticator)
        self.frames = self.ticks = 0
        self.block = TickBlock(1, TRACE_TICKS)
        self.sent_ns: list[int] = []

    def begin(self) -> None:
        """Wait for a recorder and describe the stream."""
        assert self.publisher.await_recorder(30)
        self.welcome()

    def welcome(self, session: int = SESSION) -> None:
        self.receive(CONTROL, encode_control(Welcome(session, 0, description())))

    def receive(self, path: int, data: bytes) -> None:
        now_ns = time.perf_counter_ns()
        self.publisher.captured.add(now_ns, path, data)
        if path == CONTROL:
            self.publisher.captured.welcome(now_ns, data)

    def publish(self, ms: int, session: int = SESSION) -> None:
        """Publish the ticks of some ms, with frames and statuses."""
        for _ in range(ms):
            if self.tick(session):
                self.status("playing")

    def tick(self, session: int = SESSION) -> bool:
        """Tick, with a frame every fifth time; return whether a status is due."""
        now_ns = time.perf_counter_ns()
        if self.ticks % BATCH == 0:
            self.receive(0, encode_frame(numbered_frame(self.frames, session)))
            self.frames += 1
            self.sent_ns.append(now_ns)
        self.block.add([TickState(now_ns, now_ns, self.ticks * MS, 0.5, self.ticks * 1e-3, True)])
        self.ticks += 1
        if self.block.count < self.block.most:
            return False
        self._add_block()
        return self.publisher.publish()

    def _add_block(self) -> None:
        if self.block.count:
            self.publisher.trace.add(self.block)
            self.block.count = 0

    def status(self, state: str, summary: Summary | None = None, final: bool = False) -> None:
        data = pack_status(state, "test pulse", summary or Summary(), final)
        if final:
            self._add_block()
            self.publisher.finish(data)
        else:
            self.publisher.status(data)


def numbered_frame(number: int, session: int = SESSION) -> Frame:
    """Return a frame whose values follow from its number, and are no exact float32."""
    first = number * BATCH
    values = (np.arange(first, first + BATCH)[:, np.newaxis] * 0.1 + math.pi).astype("<f4")
    return Frame(session, first, 1_000 * MS + first * MS, MS, values)


def clock_reply(t1_ns: int, ahead_ns: int, session: int = SESSION) -> bytes:
    return encode_control(ClockReply(session, t1_ns, t1_ns + ahead_ns, t1_ns + ahead_ns))


def bye(samples_sent: int) -> bytes:
    return encode_control(Bye(SESSION, samples_sent))


def trace_message(*felt: TickState, others: Sequence[TickState] = ()) -> Message:
    """Return ticks as a trace message; others: states of further contactors, at each tick."""
    return TRACE, packed_trace(*felt, others=others)


Kind = TypeVar("Kind", bound=TelemetryPublisher)


@contextmanager
def publishing(
    address: str,
    keys: ServerKeys | None = None,
    kind: type[Kind] = TelemetryPublisher,
) -> Iterator[Kind]:
    """Provide a publisher with a socket of its own."""
    context: sockets.Context = zmq.Context()
    try:
        yield kind(context, address, keys)
    finally:
        context.destroy(linger=200)


class HandmadeTelemetry:
    """A display's telemetry, made message by message and read by a decoder."""

    def __init__(self) -> None:
        self.decoder = TelemetryDecoder()
        self.restart(1)

    def restart(self, run: int, ahead_ns: int = WALL_NS) -> None:
        self.ahead_ns = ahead_ns
        self.capture = CaptureWriter(run)
        self.capture.follow(SUBSCRIBED)

    def receive(self, *messages: tuple[int, bytes], at_ns: int = NOW_NS) -> list[Entry]:
        for path, data in messages:
            self.capture.add(at_ns, path, data)
        return [
            entry
            for part in self.capture.take(at_ns, at_ns + self.ahead_ns)
            for entry in self.decoder.decode(CAPTURE, part)
        ]

    def status(self, state: str, final: bool = False, **changes: object) -> list[Entry]:
        summary = Summary(**changes)
        message = pack_status(state, "pulse", summary, final, playing=[PLAYING])
        self.capture.statuses_published += 1
        return self.decoder.decode(STATUS, message)

    def ticks(self, *felt: TickState) -> list[Entry]:
        """Publish a trace of at most 20 ticks."""
        self.capture.traces_published += 1
        return self.decoder.decode(*trace_message(*felt))
