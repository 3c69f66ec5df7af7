"""The sensing node on real sockets: the sending loop, and its telemetry."""

import logging
import math
import secrets
import time
from collections.abc import Callable

import zmq

from protocol import sockets
from protocol.config.quantities import count_text
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.security.link_keys import ServerKeys
from protocol.summary.fields import PressFigures, SampleCounts, Summary
from protocol.wire.description import StreamDescription
from protocol.wire.messages import HEADER_BYTES, Bye, encode_control, encode_frame
from protocol.wire.telemetry import STATUS, pack_status
from pulse_sensors.sample_plausibility import SampleCheck
from sensing_node.control_server import ControlServer, RequestBudget, Sender
from sensing_node.feeds import Framer, SourceOrFeed, feed_of, probe_faults, sensor_notes
from sensing_node.press.set_points import REASONS
from sensing_node.scene import serve_set_points

logger = logging.getLogger(__name__)

SILENCE_CHECK_NS = 1_000_000_000
# Longest wait, and so the longest time until Ctrl-C takes effect: a wait continues after a signal.
MAX_WAIT_NS = 50_000_000
FOREVER_NS = 1 << 62
# Time from the start of the loop until the source's first sample is due.
START_NS = 20_000_000
# Messages that are answered between two batches even if the next batch is late, so that each of
# many displays is answered.
LEAST_ANSWERED = 50
# Longest wait at the end, in which TCP can repeat what a bad link has lost; for displays whose
# connection is closed, the time to connect anew. A wait is named if it is longer than the last one.
FAREWELL_NS, CLOSED_NS, NAMED_NS = 3_000_000_000, 1_000_000_000, 200_000_000
STATUS_EVERY_NS = 1_000_000_000
MAX_READERS = 32
# Frames that queue for longer than a second are too old to be played
# (docs/decisions/0022-a-backlog-is-bounded-by-time.md).
BACKLOG_NS = 1_000_000_000
LEAST_FRAMES = 16
# Size of a packet in the kernel besides its bytes.
PACKET_BYTES = 1_024
# Largest size that Linux accepts by default (and doubles). For streams that need more, the option
# is not set; Linux then permits up to 4 MB.
MOST_BYTES = 212_992


def queue_limits(description: StreamDescription) -> dict[int, int]:
    """Return the socket options that bound what queues for each display."""
    frames = BACKLOG_NS / (description.batch * description.period_ns)
    values = description.batch * len(description.channels)
    frame_bytes = HEADER_BYTES + PACKET_BYTES + values * description.bytes_per_sample
    options: dict[int, int] = {zmq.SNDHWM: max(LEAST_FRAMES, math.ceil(frames))}
    kernel_bytes = math.ceil(max(frames, LEAST_FRAMES) * frame_bytes / 2)
    if kernel_bytes <= MOST_BYTES:
        options[zmq.SNDBUF] = kernel_bytes
    return options


class Telemetry:
    """Publisher of the node's status, once a second. Raises AddressError."""

    def __init__(self, context: sockets.Context, address: str) -> None:
        self._authenticator = Authenticator(context, None, most=MAX_READERS)
        self.rejected = self._authenticator.rejected
        self._socket = sockets.bind(context, zmq.XPUB, address, self._authenticator)
        self._subscriptions = SubscriptionBudget(self._socket, (STATUS,))
        self._next_ns = 0
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def due(self, now_ns: int) -> bool:
        """Return whether a status is due; call it often."""
        self._authenticator.poll(now_ns)
        self._subscriptions.poll()
        if now_ns < self._next_ns:
            return False
        self._next_ns = now_ns + STATUS_EVERY_NS
        return True

    def publish(self, status: bytes) -> None:
        """Publish a status."""
        sockets.send(self._socket, STATUS, status)


class SensingNode:
    """A sensing node that streams one source and answers its displays.

    Parameters
    ----------
    address : str
        Address of the data; control uses the next port.
    clock : callable
        Clock of the stream in ns.
    keys : ServerKeys, optional
        This node's pair and its allow-list; None admits every display.
    telemetry_address : str, optional
        Address at which a status is published every second; None publishes none.

    Raises
    ------
    AddressError
    """

    def __init__(
        self,
        source: SourceOrFeed,
        description: StreamDescription,
        address: str,
        clock: Callable[[], int] = time.perf_counter_ns,
        keys: ServerKeys | None = None,
        telemetry_address: str | None = None,
    ) -> None:
        self._source = source
        self._description = description
        self._clock = clock
        self._stopping = self._full = self._refused_version = False
        # At the end: whether displays are waited for, as the log states, and whether no longer.
        self._awaiting = self._hurried = False
        self._refused_set_points: set[str] = set()
        self._session = secrets.randbits(62)
        self._framer = Framer(description, self._session)
        self._check = SampleCheck(description.period_ns, description.channels)
        self._server = ControlServer(
            description, self._session, serve_set_points(source, self._session)
        )
        self._requests = RequestBudget()
        self._context: sockets.Context = zmq.Context()
        self._authenticator = Authenticator(self._context, keys)
        context, authenticator = self._context, self._authenticator
        control_address, limits = sockets.control_address(address), queue_limits(description)
        self._control = sockets.bind(context, zmq.ROUTER, control_address, authenticator)
        self._data = sockets.bind(context, zmq.XPUB, address, authenticator, limits)
        self._subscriptions = SubscriptionBudget(self._data, (b"",))
        self._telemetry = None
        if telemetry_address is not None:
            self._telemetry = Telemetry(self._context, telemetry_address)

    @property
    def telemetry_address(self) -> str:
        """Address at which statuses are published; empty without telemetry."""
        return "" if self._telemetry is None else self._telemetry.address

    def stop(self) -> None:
        """End the stream after the present batch; later, wait for no display any more."""
        self._hurried = self._awaiting
        self._stopping = True

    def run(self, seconds: float | None = None) -> Summary:
        """Stream until `stop`, the end of the source, or the samples of `seconds` are sent."""
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
                    for frame in self._framer.frames(block):
                        sockets.send(self._data, encode_frame(frame))
                    self._check.add(block.values)
                self._subscriptions.poll()
                if due_ns >= next_check_ns:
                    next_check_ns = due_ns + SILENCE_CHECK_NS
                    for client in self._server.forget_silent(self._clock()):
                        if not client.is_announced:
                            continue
                        if client.confirmed:
                            logger.info(f"{client.shown_name} left")
                        else:
                            logger.warning(f"{client.shown_name} is silent, forgotten")
                    self._requests.expect(len(self._server.clients))
                    self._name_other_version()
            self._name_other_version()
            self._finish()
            return self._summary()
        finally:
            self._context.destroy(linger=sockets.LINGER_MS)

    def _serve_until(self, due_ns: int) -> None:
        """Answer displays until the next batch is due; answer once if it is due already."""
        while not self._stopping:
            self._answer_all(due_ns)
            if self._telemetry is not None and self._telemetry.due(self._clock()):
                self._telemetry.publish(self._status(final=False))
            self._wait(due_ns - self._clock())
            if self._clock() >= due_ns:
                return  # the batch goes out before further answers

    def _wait(self, timeout_ns: int) -> None:
        """Sleep until a message may be read, at most `timeout_ns`."""
        waited_for = self._authenticator.own_sockets
        longest_ns = self._requests.held_for_ns(self._clock())
        if not longest_ns:
            waited_for, longest_ns = [self._control, *waited_for], MAX_WAIT_NS
        sockets.wait_readable(waited_for, min(timeout_ns, longest_ns))

    def _answer_all(self, until_ns: int) -> None:
        """Answer waiting messages until a time; the rest waits until the next batch is sent."""
        self._authenticator.poll(time.perf_counter_ns())
        if self._requests.held_for_ns(self._clock()):
            return
        for number, (*envelope, data) in enumerate(sockets.receive_multipart(self._control)):
            self._answer(tuple(envelope), data)
            now_ns = self._clock()
            if not self._requests.spend(now_ns):
                if self._requests.held == 1:
                    logger.warning(
                        f"{count_text(len(self._server.clients), 'display')} here, which send far"
                        " more than displays do; excess messages are left unread"
                    )
                return
            if number >= LEAST_ANSWERED and now_ns >= until_ns:
                return

    def _answer(self, sender: Sender, data: bytes) -> None:
        clients = self._server.clients
        known = len(clients)
        reply = self._server.answer(sender, data, self._clock(), self._framer.next_sample)
        if reply is not None:
            sockets.send(self._control, *sender, encode_control(reply))
        if self._server.set_points is not None:
            for cause in self._server.set_points.rejected.keys() - self._refused_set_points:
                self._refused_set_points.add(cause)
                logger.warning(f"refused a set-point: {REASONS[cause]}")
        if len(clients) > known:
            self._requests.expect(len(clients))
        client = clients.get(sender)
        # It may send requests before its name.
        if client is not None and client.name and not client.is_announced:
            client.is_announced = True
            logger.info(f"{client.shown_name} joined")
        if self._server.rejected["too_many_displays"] and not self._full:
            self._full = True
            logger.warning(
                f"{count_text(len(clients), 'display')} here, which is the most;"
                " no further one is answered"
            )

    def _name_other_version(self) -> None:
        if self._server.other_version and not self._refused_version:
            self._refused_version = True
            logger.warning(f"refused: {self._server.other_version}")

    def _finish(self) -> None:
        """Send every display the end of the stream, and wait until each has received all of it.

        If a socket is closed too early, any message of its peer makes TCP drop the unsent rest.
        """
        bye = encode_control(Bye(self._session, self._framer.next_sample))
        informed, closed = set[Sender](), set[Sender]()
        begin_ns = self._clock()
        while not self._hurried:
            self._answer_all(begin_ns + FAREWELL_NS)
            for sender in self._server.clients.keys() - informed:
                informed.add(sender)
                if not self._send_if_connected(sender, bye):
                    closed.add(sender)
            missing, waited_ns = self._server.unconfirmed, self._clock() - begin_ns
            longest_ns = CLOSED_NS if missing.keys() <= closed else FAREWELL_NS
            if not missing or waited_ns >= longest_ns:
                break
            if waited_ns >= NAMED_NS and not self._awaiting:
                self._awaiting = True
                names = ", ".join(client.shown_name for client in missing.values())
                logger.info(
                    f"ending: waiting up to {longest_ns * 1e-9:g} s for"
                    f" {count_text(len(missing), 'display')} to confirm the end of the stream"
                    f" ({names:.80}); Ctrl-C again ends at once"
                )
            self._wait(MAX_WAIT_NS)
        if (probe := self._source.pressed) is not None:
            probe.leave()
        for client in self._server.clients.values():
            if (report := client.report) is not None:
                logger.info(
                    f"{client.shown_name} last reported {report.played} played,"
                    f" {report.predicted} predicted, {report.late} late, {report.lost} lost,"
                    f" playout delay {report.playout_delay_ms:.1f} ms"
                )
        if self._telemetry is not None:
            self._telemetry.publish(self._status(final=True))

    def _send_if_connected(self, sender: Sender, message: bytes) -> bool:
        """Send a control message; return False if the connection to the display is closed."""
        self._control.setsockopt(zmq.ROUTER_MANDATORY, 1)
        try:
            sockets.send(self._control, *sender, message)
        except zmq.ZMQError as error:
            if error.errno != zmq.EHOSTUNREACH:
                raise
            return False
        finally:
            self._control.setsockopt(zmq.ROUTER_MANDATORY, 0)
        return True

    def _status(self, final: bool) -> bytes:
        state = "ended" if final else "streaming"
        displays, name = len(self._server.clients), self._description.name
        return pack_status(state, name, self._summary(), final, self._session, displays)

    def _summary(self) -> Summary:
        rejected = self._server.rejected + self._subscriptions.rejected
        rejected += self._authenticator.rejected
        if self._requests.held:
            rejected["held_back"] = self._requests.held
        rejected += self._source.rejected
        press = PressFigures()
        if (set_points := self._server.set_points) is not None:
            rejected += set_points.rejected
            press = set_points.figures()
        return Summary(
            samples=SampleCounts(sent=self._framer.next_sample),
            limited=self._source.limits(),
            press=press,
            rejected=dict(rejected),
            rejected_readers={} if self._telemetry is None else dict(self._telemetry.rejected),
            faults=probe_faults(self._source),
            notes=sensor_notes(self._source, self._check),
        )
