"""Frames from the sensing node to displays: once for all of them, and only while one listens."""

from collections import Counter

from display_node.reception.data_path import DataPath
from display_node.reception.endpoint import ANSWER_NS
from display_node.reception.failover import PATIENCE_FRAMES
from protocol import sockets
from protocol.errors import WireError
from protocol.security.subscription_budget import SubscriptionBudget
from protocol.wire.messages import decode_frame

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
