"""The sensing node's shell: sockets, the clock on the wall, and the sending loop."""

import logging
import secrets
import time
from collections.abc import Callable

import zmq

from protocol import sockets
from protocol.config.quantities import count_text
from protocol.run_summary import Summary
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.security.keys import ServerKeys
from protocol.summary_tables import SampleCounts
from protocol.wire.messages import Bye, encode_control, encode_frame
from protocol.wire.stream import StreamDescription
from protocol.wire.telemetry import pack_status
from sensing_node.conditioning import faults_of, limits_of
from sensing_node.control_server import ControlServer, QuestionBudget, Sender
from sensing_node.framer import Framer
from sensing_node.send_queue import limits
from sensing_node.sources.live import LiveSource, Source, feed_of
from sensing_node.sources.plausibility import SampleCheck
from sensing_node.telemetry import Telemetry

logger = logging.getLogger(__name__)

SILENCE_CHECK_NS = 1_000_000_000
# Python goes on waiting after a signal: however long a batch is, Ctrl-C is heeded this soon.
MAX_WAIT_NS = 50_000_000
FOREVER_NS = 1 << 62
# Room for the source's first samples to be ready before they are due.
START_NS = 20_000_000
# Between two batches, however late the next one is: with many displays, each is answered in time.
LEAST_ANSWERED = 50
# At its end TCP may have to repeat what a bad link has lost, and what queued behind it.
FAREWELL_NS = 3_000_000_000


class SensingNode:
    """Streams one source on real sockets and answers its displays."""

    def __init__(
        self,
        source: Source,
        description: StreamDescription,
        address: str,
        clock: Callable[[], int] = time.monotonic_ns,
        keys: ServerKeys | None = None,
        telemetry_address: str | None = None,
    ) -> None:
        """Bind the sockets.

        clock: times the stream, ns. keys: of displays that may connect; None admits everybody.
        telemetry_address: where a status is published every second; None: nowhere.

        Raises AddressError when `address` cannot be bound, KeyFileError.
        """
        self._source = source
        self._description = description
        self._clock = clock
        self._stopping = False
        self._full = False
        self._session = secrets.randbits(62)
        self._framer = Framer(description, self._session)
        self._check = SampleCheck(description.period_ns)
        self._desk = ControlServer(description, self._session)
        self._questions = QuestionBudget()
        self._context: sockets.Context = zmq.Context()
        gate = Authenticator(self._context, keys)
        control = sockets.control_address(address)
        self._control = sockets.bind(self._context, zmq.ROUTER, control, gate)
        self._data = sockets.bind(self._context, zmq.XPUB, address, gate, limits(description))
        self._subscribers = SubscriptionBudget(self._data, (b"",))
        self._gate = gate
        self._telemetry = None
        if telemetry_address is not None:
            self._telemetry = Telemetry(self._context, telemetry_address)
        self._waited_for = [self._control, *gate.sockets]

    @property
    def telemetry_address(self) -> str:
        """Address at which statuses are published; empty where none are."""
        return "" if self._telemetry is None else self._telemetry.address

    def stop(self) -> None:
        """End the stream after the present batch."""
        self._stopping = True

    def run(self, seconds: float | None = None) -> Summary:
        """Stream until stopped, the source has ended, or the samples of `seconds` are sent."""
        start_ns = self._clock() + START_NS
        feed = feed_of(self._source, start_ns)
        last_ns = start_ns + (FOREVER_NS if seconds is None else round(seconds * 1e9)) - 1
        next_check_ns = start_ns
        try:
            while not self._stopping and not feed.exhausted and feed.due_ns(1) <= last_ns:
                due_ns = min(feed.due_ns(self._description.batch), last_ns)
                self._serve_until(due_ns)
                now_ns = min(self._clock(), last_ns)
                while (block := feed.read(now_ns)) is not None:
                    self._check.add(block.values)
                    for frame in self._framer.frames(block):
                        sockets.send(self._data, encode_frame(frame))
                self._subscribers.poll()
                if due_ns >= next_check_ns:
                    next_check_ns = due_ns + SILENCE_CHECK_NS
                    self._forget_silent()
            self._see_off()
            self._log_reports()
            if self._telemetry is not None:
                self._telemetry.publish(self._status(final=True))
            return self._summary()
        finally:
            self._context.destroy(linger=sockets.LINGER_MS)

    def _serve_until(self, due_ns: int) -> None:
        """Answer displays until the next batch is due, and once where it is due already."""
        while not self._stopping:
            self._answer_all(due_ns)
            if self._telemetry is not None and self._telemetry.due(self._clock()):
                self._telemetry.publish(self._status(final=False))
            self._wait(due_ns - self._clock())
            if self._clock() >= due_ns:
                return  # the batch goes out before further answers

    def _wait(self, timeout_ns: int) -> None:
        """Sleep until something waits that may be read, at most `timeout_ns`."""
        held_ns = self._questions.held_for_ns(self._clock())
        if held_ns:
            sockets.wait_readable(self._gate.sockets, min(timeout_ns, held_ns))
        else:
            sockets.wait_readable(self._waited_for, min(timeout_ns, MAX_WAIT_NS))

    def _answer_all(self, until_ns: int) -> None:
        """Answer what waits; what is left then waits until the next batch was sent."""
        self._gate.poll(time.monotonic_ns())
        if self._questions.held_for_ns(self._clock()):
            return
        for number, (*envelope, data) in enumerate(sockets.receive_all(self._control)):
            self._answer(tuple(envelope), data)
            now_ns = self._clock()
            if not self._questions.spend(now_ns):
                self._name_flood()
                return
            if number >= LEAST_ANSWERED and now_ns >= until_ns:
                return

    def _name_flood(self) -> None:
        if self._questions.held == 1:
            logger.warning(
                f"{count_text(len(self._desk.guests), 'display')} here, which send far more than"
                " displays do; what is too much is left unread"
            )

    def _answer(self, sender: Sender, data: bytes) -> None:
        known = len(self._desk.guests)
        reply = self._desk.answer(sender, data, self._clock(), self._framer.samples_sent)
        if reply is not None:
            sockets.send(self._control, *sender, encode_control(reply))
        if len(self._desk.guests) > known:
            self._questions.expect(len(self._desk.guests))
            logger.info(f"{self._desk.guests[sender].shown_name} joined")
        elif self._desk.rejected["too_many_displays"] and not self._full:
            self._full = True
            logger.warning(
                f"{count_text(known, 'display')} here, which is the most;"
                " no further one is answered"
            )

    def _forget_silent(self) -> None:
        for guest in self._desk.forget_silent(self._clock()):
            logger.warning(f"{guest.shown_name} is silent, forgotten")
        self._questions.expect(len(self._desk.guests))

    def _see_off(self) -> None:
        """Tell every display where the stream ended, and stay until each has all of it.

        Where a socket is closed before its peer has everything, whatever the peer sends makes TCP
        drop the rest.
        """
        bye = encode_control(Bye(self._session, self._framer.samples_sent))
        told: set[Sender] = set()
        until_ns = self._clock() + FAREWELL_NS
        while self._clock() < until_ns:
            self._answer_all(until_ns)
            for sender in self._desk.guests.keys() - told:
                told.add(sender)
                sockets.send(self._control, *sender, bye)
            if self._desk.all_content:
                return
            self._wait(MAX_WAIT_NS)

    def _status(self, final: bool) -> bytes:
        state = "ended" if final else "streaming"
        displays, name = len(self._desk.guests), self._description.name
        return pack_status(state, name, self._summary(), final, self._session, displays)

    def _log_reports(self) -> None:
        for guest in self._desk.guests.values():
            if guest.report is not None:
                report = guest.report
                logger.info(
                    f"{guest.shown_name} last reported {report.played} played, {report.late} late,"
                    f" {report.lost} lost, playout delay {report.playout_delay_ms:.1f} ms"
                )

    def _summary(self) -> Summary:
        rejected = self._desk.rejected + self._subscribers.rejected + self._gate.rejected
        if self._questions.held:
            rejected["held_back"] = self._questions.held
        if self._telemetry is not None:
            rejected = rejected + self._telemetry.rejected
        if isinstance(self._source, LiveSource):
            rejected = rejected + self._source.rejected
            faults = self._source.faults()
        else:
            faults = faults_of(self._source)
        return Summary(
            samples=SampleCounts(sent=self._framer.samples_sent),
            limited=limits_of(self._source),
            rejected=dict(rejected),
            faults=[*faults, *self._check.faults()],
        )
