"""Relay of one stream: displays on one side, a sensing node or a further relay on the other."""

import itertools
import logging
import math
import struct
import threading
import time
from collections import Counter
from contextlib import suppress

import zmq

from display_node.reception.addresses import Lookup
from display_node.reception.failover import DataPath
from display_node.reception.timeouts import (
    ANSWER_NS,
    CUT_NS,
    PATIENCE_FRAMES,
    PATIENCE_NS,
    Timeouts,
)
from protocol import sockets
from protocol.config.quantities import count_text
from protocol.errors import ProcessError, WireError
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.security.handshakes import HandshakeMonitor
from protocol.security.link_keys import ClientKeys, ServerKeys
from protocol.summary.fields import FrameCounts, Reconnections, Summary
from protocol.wire.messages import decode_frame

logger = logging.getLogger(__name__)

_SUBSCRIBED = b"\1"
STATISTICS = struct.Struct("=Q")
# The proxy answers at once, unless its thread gets no processor time.
ANSWER_MS = 5_000
# Interval at which a frame is decoded, to get the duration that a frame covers.
READ_EVERY_NS = 100_000_000
# Timeout of a stream whose frames have an unknown length, and the longest of any stream.
MAX_SILENT_NS = 10_000_000_000
CHECK_EVERY_NS = 100_000_000
# Time until Ctrl-C takes effect.
WAIT_NS = 50_000_000
_numbers = itertools.count()


class Proxy:
    """ZeroMQ's own proxy between a socket for displays and one to the sensing node, in a thread.

    While the proxy runs, the sockets belong to its thread; after `stop` the caller may use them.

    requests, received: message parts passed to the sensing node and from it, over all runs.
    received_bytes: bytes from the sensing node. dropped: messages dropped because the queue to the
    sensing node was full.
    """

    def __init__(
        self, context: sockets.Context, displays: sockets.Socket, sensing: sockets.Socket
    ) -> None:
        # Without a timeout, a full queue would block the proxy's thread forever.
        sensing.setsockopt(zmq.SNDTIMEO, 0)
        self._context, self.displays, self.sensing = context, displays, sensing
        self.requests = self.received = self.received_bytes = self.dropped = 0
        self._last_counts = (0, 0, 0)
        self._steering: sockets.Socket | None = None
        self._thread: threading.Thread | None = None
        # Whether a question about the counts has no answer yet.
        self._asked = False

    def start(self) -> None:
        """Start passing messages on."""
        address = f"inproc://proxy-{next(_numbers)}"
        self._steering = self._context.socket(zmq.PAIR)
        for timeout in (zmq.RCVTIMEO, zmq.SNDTIMEO):
            self._steering.setsockopt(timeout, ANSWER_MS)
        self._steering.bind(address)
        steered = self._context.socket(zmq.PAIR)
        steered.connect(address)
        self._last_counts, self._asked = (0, 0, 0), False
        # A daemon thread, so that the program can end even if the proxy hangs.
        self._thread = threading.Thread(target=self._run, args=(steered,), daemon=True)
        self._thread.start()

    def update_counts(self) -> None:
        """Bring the counts up to date; where the proxy's thread is late, at a later update."""
        if self._steering is None:
            return
        # An answer that came late is that of an earlier time, and not the next question's.
        for _ in sockets.receive_multipart(self._steering):
            self._asked = False
        if self._asked:
            return
        try:
            self._steering.send(b"STATISTICS")
            self._asked = True
            answer = self._steering.recv_multipart()
        except zmq.Again:
            return
        self._asked = False
        numbers = [number for part in answer for number in STATISTICS.unpack(part)]
        requests, received, received_bytes = numbers[0], numbers[4], numbers[5]
        # The proxy counts from zero after it had to start again.
        last = self._last_counts
        before = last if requests >= last[0] and received >= last[1] else (0, 0, 0)
        self.requests += requests - before[0]
        self.received += received - before[1]
        self.received_bytes += received_bytes - before[2]
        self._last_counts = (requests, received, received_bytes)

    def stop(self) -> bool:
        """Give the sockets back; messages queued on them stay queued.

        Returns False, and keeps the sockets, where the proxy's thread does not end in time.
        """
        if self._steering is None or self._thread is None:
            return True
        self.update_counts()
        # A proxy that has ended by itself receives nothing.
        with suppress(zmq.Again):
            self._steering.send(b"TERMINATE")
        self._thread.join(ANSWER_MS * 1e-3)
        if self._thread.is_alive():
            return False
        self._steering.close(0)
        self._steering = self._thread = None
        return True

    def _run(self, steered: sockets.Socket) -> None:
        """Pass messages on until stopped; a message that finds the queue full is dropped."""
        with suppress(zmq.ContextTerminated):
            while True:
                try:
                    zmq.proxy_steerable(self.displays, self.sensing, None, steered)
                    break
                except zmq.Again:
                    self.dropped += 1
                    # Drop the rest of that message: ZeroMQ drops whole messages or none.
                    while self.displays.getsockopt(zmq.RCVMORE):
                        self.displays.recv(zmq.NOBLOCK)
            steered.close(0)


class FrameForwarder:
    """Forwarder of frames from a data path to a bound XPUB socket.

    The relay subscribes to the path while at least one display is subscribed. Like a display, it
    opens a second connection beside a silent one.

    received, received_bytes: frames received; copies over two connections count once.
    """

    def __init__(
        self, displays: sockets.Socket, path: DataPath, subscribers: SubscriptionBudget
    ) -> None:
        self.received = self.received_bytes = 0
        self.rejected: Counter[str] = subscribers.rejected
        self.sockets = [displays, *(endpoint.socket for endpoint in path.endpoints)]
        self._path, self._displays, self._subscribers = path, displays, subscribers
        self._subscribed = False
        self._next_read_ns = 0
        self._set_timeout(MAX_SILENT_NS)

    def poll(self, now_ns: int) -> None:
        """Follow the displays' subscriptions and pass the received frames on.

        Call it whenever one of `sockets` is readable.
        """
        for event in self._subscribers.receive():
            wanted = event == _SUBSCRIBED
            if wanted and not self._subscribed:
                self._path.subscribe(now_ns)
            elif self._subscribed and not wanted:
                self._path.unsubscribe()
            self._subscribed = wanted
        frame = None
        for frame in self._path.messages():
            self.received += 1
            self.received_bytes += len(frame)
            sockets.send(self._displays, frame)
        if frame is not None and now_ns >= self._next_read_ns:
            self._next_read_ns = now_ns + READ_EVERY_NS
            # Displays refuse and count a frame that cannot be decoded.
            with suppress(WireError):
                read = decode_frame(frame)
                self._set_timeout(len(read.values) * read.period_ns)
        self._path.take_received(now_ns)

    def connect(self, now_ns: int, address: str | None) -> None:
        """Connect the path where needed; call it often.

        address: the sensing node's address, if a look-up has just ended.
        """
        if self._subscribed or self._path.first.address is None:
            self._path.poll(now_ns, address)

    def _set_timeout(self, frame_ns: int) -> None:
        longest_ns = MAX_SILENT_NS // PATIENCE_FRAMES
        self._path.failover.set_timeouts(Timeouts(min(frame_ns, longest_ns)))


class UnansweredDetector:
    """Detector of a dead connection from the counts of requests and of received messages. Pure.

    timeout_ns: longest time from a request to the next received message. after_first_message:
    report nothing before a first message was received.
    """

    def __init__(self, timeout_ns: int, after_first_message: bool = False) -> None:
        self._timeout_ns, self._after_first_message = timeout_ns, after_first_message
        self._requests = self._received = 0
        self._since_ns: int | None = None
        self.restart()

    def is_silent(self, now_ns: int, requests: int, received: int) -> bool:
        """Return True where a request has had no answer for longer than the timeout.

        If there are no requests, silence is not a fault.
        """
        if received != self._received:
            self._since_ns = None
            self._armed = True
        elif requests != self._requests and self._since_ns is None:
            self._since_ns = now_ns
        self._requests, self._received = requests, received
        if self._since_ns is None or not self._armed:
            return False
        return now_ns - self._since_ns >= self._timeout_ns

    def restart(self) -> None:
        """Restart the timeout for a new connection."""
        self._since_ns = None
        self._armed = not self._after_first_message


class Relay:
    """Relay of one stream, and of the control messages between its displays and sensing node.

    Control messages are not decoded. The first display that subscribes makes the relay subscribe
    to the frames, once for all displays. A display that reads too slowly loses the newest frames,
    as it does at the sensing node.

    connect, bind: address of the sensing node, and the address for displays. client_keys: keys
    towards the sensing node. server_keys: keys towards displays, with the allow-list.

    Raises AddressError.
    """

    def __init__(
        self,
        connect: str,
        bind: str,
        client_keys: ClientKeys | None = None,
        server_keys: ServerKeys | None = None,
    ) -> None:
        sockets.control_address(connect)
        control = sockets.control_address(bind)
        self._connect, self._stopping = connect, False
        context: sockets.Context = zmq.Context()
        self._context = context
        self._authenticator = Authenticator(context, server_keys)
        self._handshakes = HandshakeMonitor(context, client_keys)
        self._path = DataPath(context, client_keys)
        control_in = sockets.unconnected(context, zmq.DEALER, client_keys)
        data_in = [endpoint.socket for endpoint in self._path.endpoints]
        self._handshakes.watch([control_in, *data_in], lambda: connect)
        data_out = sockets.bind(context, zmq.XPUB, bind, self._authenticator)
        budget = SubscriptionBudget(data_out, (b"",))
        self._frames = FrameForwarder(data_out, self._path, budget)
        control_out = sockets.bind(context, zmq.ROUTER, control, self._authenticator)
        self._control = Proxy(context, control_out, control_in)
        # `_cut` watches data and control together, `_unanswered` control alone.
        self._cut = UnansweredDetector(CUT_NS, after_first_message=True)
        self._unanswered = UnansweredDetector(PATIENCE_NS)
        self._lookup = Lookup(connect)
        self._address: str | None = None
        self._next_check_ns = 0
        # Frames received when control was connected last.
        self._received_before = 0
        self._reconnections = 0

    def stop(self) -> None:
        """Make `run` return within 50 ms."""
        self._stopping = True

    def run(self, seconds: float | None = None) -> Summary:
        """Pass messages on until stopped, or for `seconds`."""
        end_ns = math.inf if seconds is None else time.perf_counter_ns() + seconds * 1e9
        self._lookup.start()
        readable = [*self._frames.sockets, *self._authenticator.own_sockets]
        try:
            self._control.start()
            while not self._stopping and (now_ns := time.perf_counter_ns()) < end_ns:
                self._poll(now_ns)
                sockets.wait_readable(readable, WAIT_NS)
        finally:
            # The context waits for all sockets, also for those of a proxy that does not end.
            if self._control.stop():
                self._context.destroy(linger=sockets.LINGER_MS)
        return self._summary()

    def _poll(self, now_ns: int) -> None:
        """Connect once the sensing node's address is known, and again where it is silent."""
        self._frames.poll(now_ns)
        if answered := self._handshakes.poll(now_ns):
            for endpoint in self._path.endpoints:
                if endpoint.socket in answered:
                    endpoint.answer(now_ns)
        self._authenticator.poll(now_ns)
        # `running` is read first: a look-up that ends in between would otherwise be started again.
        looking, address = self._lookup.running, self._lookup.take()
        if address is not None:
            self._connect_control(address)
        self._frames.connect(now_ns, address)
        if now_ns < self._next_check_ns:
            return
        self._next_check_ns = now_ns + CHECK_EVERY_NS
        self._control.update_counts()
        requests, answers = self._control.requests, self._control.received
        # Displays that send clock requests expect frames as well, so data counts as an answer.
        cut = self._cut.is_silent(now_ns, requests, answers + self._frames.received)
        unanswered = self._unanswered.is_silent(now_ns, requests, answers)
        if cut:
            self._path.failover.give_up()
        wanted = self._address is None or cut or unanswered
        if wanted and not looking and address is None:
            self._lookup.start()

    def _connect_control(self, address: str) -> None:
        """Connect control to `address`, and drop what is queued for the old connection.

        If no frames arrived since the last reconnection, the data path is dropped too.
        """
        if self._address is not None:
            self._reconnections += 1
            if self._reconnections == 1:
                logger.warning(f"{self._connect} is silent; reconnecting until it answers")
            if self._frames.received == self._received_before:
                self._path.failover.give_up()
        self._received_before = self._frames.received
        # The kernel retries a connection only after 1 s, too late where a cut has ended, so a
        # short timeout is set. A slow path needs longer: every second attempt has no timeout.
        answer_ns = ANSWER_NS if self._reconnections % 2 else 0
        if not self._control.stop():
            raise ProcessError(f"the relay of {self._connect} hangs: start it again")
        before, control = self._address, sockets.control_address
        sockets.reconnect(
            self._control.sensing, before and control(before), control(address), answer_ns
        )
        self._address = address
        for detector in (self._cut, self._unanswered):
            detector.restart()
        self._control.start()

    def _summary(self) -> Summary:
        failover = self._path.failover
        logger.info(
            f"{count_text(self._frames.received, 'frame')} ({_megabytes(self._frames)})"
            f" and {_megabytes(self._control)} of answers came from {self._connect},"
            f" {count_text(self._reconnections, 'reconnection')} of control,"
            f" {count_text(failover.opened, 'second connection')} for frames;"
            f" {self._control.dropped} requests were dropped by a full queue"
        )
        rejected = self._handshakes.rejected + self._frames.rejected + self._authenticator.rejected
        return Summary(
            frames=FrameCounts(received=self._frames.received),
            reconnections=Reconnections(failover.opened, failover.kept, self._reconnections),
            rejected=dict(rejected),
        )


def _megabytes(source: FrameForwarder | Proxy) -> str:
    return f"{source.received_bytes * 1e-6:.1f} MB"
