"""Displays on one side, a sensing node or a further relay on the other.

Whether a connection is dead: asked, it says nothing.

Frames from the sensing node to displays: once for all of them, and only while one listens.
"""

import time
from collections import Counter
from collections.abc import Callable

import zmq

from display_node.reception.connection import CUT_NS, Lookup
from display_node.reception.data_path import DataPath
from display_node.reception.endpoint import ANSWER_NS, PATIENCE_NS
from display_node.reception.failover import PATIENCE_FRAMES
from protocol import sockets
from protocol.config.quantities import count_text
from protocol.errors import WireError
from protocol.run_summary import FrameCounts, Reconnections, Summary
from protocol.security.authenticator import Authenticator
from protocol.security.handshake_monitor import HandshakeMonitor
from protocol.security.keys import ClientKeys, ServerKeys
from protocol.security.subscription_budget import SubscriptionBudget
from protocol.wire.messages import decode_frame
from telepulse.relay.proxy import Proxy

_SUBSCRIBED = b"\1"
# How long a frame is, is read from one frame in so much time.
READ_EVERY_NS = 100_000_000
# Silence of a stream whose frames are of unknown length, and the most of any stream.
MOST_SILENT_NS = 10_000_000_000


class FrameForwarder:
    """Passes frames on from a data path to a bound XPUB socket.

    While displays listen, the path is judged by its silence, as a display judges its own: a second
    connection is opened beside a silent one.

    heard, heard_bytes: frames received, of copies over two connections one.
    """

    def __init__(
        self, displays: sockets.Socket, sensing: DataPath, subscribers: SubscriptionBudget
    ) -> None:
        self.sensing = sensing
        self.heard = self.heard_bytes = 0
        self.rejected: Counter[str] = subscribers.rejected
        self.sockets = [displays, *(line.socket for line in sensing.lines)]
        self._displays = displays
        self._subscribers = subscribers
        self._wanted = False
        self._next_read_ns = 0
        self._expect(MOST_SILENT_NS // PATIENCE_FRAMES)

    def tend(self, now_ns: int) -> None:
        """Pass on what has come, see who listens; call it whenever `sockets` have something."""
        self._follow_displays(now_ns)
        frame = None
        for frame in self.sensing.messages():
            self.heard += 1
            self.heard_bytes += len(frame)
            sockets.send(self._displays, frame)
        if frame is not None and now_ns >= self._next_read_ns:
            self._next_read_ns = now_ns + READ_EVERY_NS
            self._read_length(frame)
        self.sensing.take_heard(now_ns)

    def connect(self, now_ns: int, found: str | None) -> None:
        """Connect what is to be connected; call it often.

        found: the sensing node's address, where it has just been looked up.
        """
        if self._wanted or self.sensing.first.address is None:
            self.sensing.tend(now_ns, found)

    def _read_length(self, data: bytes) -> None:
        try:
            frame = decode_frame(data)
        except WireError:
            return  # displays refuse it, and count it
        self._expect(min(len(frame.values) * frame.period_ns, MOST_SILENT_NS // PATIENCE_FRAMES))

    def _expect(self, frame_ns: int) -> None:
        self.sensing.failover.set_timeouts(frame_ns, ANSWER_NS)

    def _follow_displays(self, now_ns: int) -> None:
        for said in self._subscribers.said():
            wanted = said == _SUBSCRIBED
            if wanted == self._wanted:
                continue
            self._wanted = wanted
            if wanted:
                self.sensing.subscribe(now_ns)
            else:
                self.sensing.unsubscribe()


class SilenceDetector:
    """Watches counts of what was asked and what was heard. Pure: time comes in.

    once_heard: it says nothing of a connection that nothing has come over yet.
    """

    def __init__(self, patience_ns: int, once_heard: bool = False) -> None:
        self._patience_ns = patience_ns
        self._once_heard = once_heard
        self._speaks = not once_heard
        self._asked = self._heard = 0
        self._since_ns: int | None = None

    def lasts(self, now_ns: int, asked: int, heard: int) -> bool:
        """Whether nothing has been heard for longer than the patience after something was asked.

        Where nothing is asked, as without displays, nothing need be heard.
        """
        if heard != self._heard:
            self._since_ns = None
            self._speaks = True
        elif asked != self._asked and self._since_ns is None:
            self._since_ns = now_ns
        self._asked, self._heard = asked, heard
        if self._since_ns is None or not self._speaks:
            return False
        return now_ns - self._since_ns >= self._patience_ns

    def begin_anew(self) -> None:
        """Be patient again: the connection is new."""
        self._since_ns = None
        self._speaks = not self._once_heard


LOOK_EVERY_NS = 100_000_000
# How soon Ctrl-C is heeded.
WAIT_NS = 50_000_000


class Relay:
    """Passes one stream on, and what its displays and its sensing node tell one another.

    It decodes none of it. The first display that subscribes makes it ask the sensing node for the
    frames, once for all; a display too slow for them loses the newest, as on the sensing node.
    """

    def __init__(
        self,
        connect: str,
        bind: str,
        log: Callable[[str], None],
        client_keys: ClientKeys | None = None,
        server_keys: ServerKeys | None = None,
    ) -> None:
        """connect: where the sensing node is; bind: where displays connect. client_keys: towards
        the sensing node; server_keys: which displays are let in.

        Raises AddressError, KeyFileError.
        """
        sockets.control_address(connect)
        control = sockets.control_address(bind)
        self._connect = connect
        self._log = log
        self._stopping = False
        self._context: sockets.Context = zmq.Context()
        context = self._context
        self._gate = Authenticator(context, server_keys, log)
        self._refusals = HandshakeMonitor(context, client_keys, log)
        self._path = DataPath(context, client_keys)
        control_in = sockets.unconnected(context, zmq.DEALER, client_keys)
        for socket in (control_in, *(line.socket for line in self._path.lines)):
            self._refusals.watch(socket)
        data_out = sockets.bind(context, zmq.XPUB, bind, self._gate)
        self._frames = FrameForwarder(
            data_out, self._path, SubscriptionBudget(data_out, (b"",), log)
        )
        control_out = sockets.bind(context, zmq.ROUTER, control, self._gate)
        self._control = Proxy(context, control_out, control_in)
        # Of both connections together, and of control.
        self._cut = SilenceDetector(CUT_NS, once_heard=True)
        self._unanswered = SilenceDetector(PATIENCE_NS)
        self._lookup = Lookup(connect, log)
        self._address: str | None = None
        self._next_look_ns = 0
        # When control was connected last, so many frames had come.
        self._heard_before = 0
        self._controls = 0

    def stop(self) -> None:
        """End in a moment."""
        self._stopping = True

    def run(self, seconds: float | None = None) -> Summary:
        """Pass messages on until stopped, or `seconds` are over."""
        end_ns = None if seconds is None else time.monotonic_ns() + round(seconds * 1e9)
        self._lookup.start()
        waited_for = [*self._frames.sockets, *self._gate.sockets]
        try:
            self._control.start()
            while not self._stopping:
                now_ns = time.monotonic_ns()
                if end_ns is not None and now_ns >= end_ns:
                    break
                self._tend(now_ns)
                sockets.wait_readable(waited_for, WAIT_NS)
        finally:
            self._control.stop()
            self._context.destroy(linger=sockets.LINGER_MS)
        return self._summary()

    def _tend(self, now_ns: int) -> None:
        """Connect once the sensing node's address is known, and anew where nothing is heard."""
        self._frames.tend(now_ns)
        answered = self._refusals.tend(now_ns)
        for line in self._path.lines if answered else ():
            line.take_answer(answered)
        self._gate.tend(now_ns)
        # Asked first: what a look-up that has ended since has found is taken the next time.
        looking, found = self._lookup.running, self._lookup.take()
        if found is not None:
            self._connect_control(found)
        self._frames.connect(now_ns, found)
        if now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + LOOK_EVERY_NS
        self._control.look()
        asked, answers = self._control.asked, self._control.heard
        # A display that asks for the clock wants frames as well.
        cut = self._cut.lasts(now_ns, asked, answers + self._frames.heard)
        unanswered = self._unanswered.lasts(now_ns, asked, answers)
        if cut:
            self._path.failover.give_up()
        wanted = self._address is None or cut or unanswered
        if wanted and not looking and found is None:
            self._lookup.start()

    def _connect_control(self, address: str) -> None:
        """Connect control to `address`; what still waits for the old connection is given up with
        it. Where no frames have come either, those are waited for no longer."""
        if self._address is not None:
            self._controls += 1
            if self._controls == 1:
                self._log(f"{self._connect} is silent; connecting anew, as often as it is")
            if self._frames.heard == self._heard_before:
                self._path.failover.give_up()
        self._heard_before = self._frames.heard
        # The kernel repeats a request to connect after 1 s, which is late where a cut has ended
        # meanwhile; but a way may take longer than one hurries.
        answer_ns = ANSWER_NS if self._controls % 2 else 0
        self._control.stop()
        was, control = self._address, sockets.control_address
        sockets.reconnect(self._control.sensing, was and control(was), control(address), answer_ns)
        self._address = address
        for silence in (self._cut, self._unanswered):
            silence.begin_anew()
        self._control.start()

    def _summary(self) -> Summary:
        failover = self._path.failover
        self._log(
            f"{count_text(self._frames.heard, 'frame')} ({_megabytes(self._frames)})"
            f" and {_megabytes(self._control)} of answers came from {self._connect},"
            f" {count_text(self._controls, 'reconnection')} of control,"
            f" {count_text(failover.opened, 'second connection')} for frames;"
            f" {self._control.dropped} questions found no room"
        )
        rejected = self._refusals.rejected + self._frames.rejected + self._gate.rejected
        return Summary(
            frames=FrameCounts(received=self._frames.heard),
            reconnections=Reconnections(failover.opened, failover.kept, self._controls),
            rejected=dict(rejected),
        )


def _megabytes(way: FrameForwarder | Proxy) -> str:
    return f"{way.heard_bytes * 1e-6:.1f} MB"
