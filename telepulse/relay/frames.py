"""Frames from the sensing node to displays: once for all of them, and only while one listens."""

from collections import Counter

import zmq

from protocol import sockets
from protocol.subscribers import Subscribers

_ALL = b""
_SUBSCRIBED = b"\1"


class Frames:
    """Passes frames on from a SUB socket to a bound XPUB socket.

    heard, heard_bytes: what came.
    """

    def __init__(
        self, displays: sockets.Socket, sensing: sockets.Socket, subscribers: Subscribers
    ) -> None:
        self.sensing = sensing
        self.heard = self.heard_bytes = 0
        self.rejected: Counter[str] = subscribers.rejected
        self.sockets = [displays, sensing]
        self._displays = displays
        self._subscribers = subscribers
        self._wanted = False

    def tend(self) -> None:
        """Pass on what has come, see who listens; call it whenever `sockets` have something."""
        self._follow_displays()
        for frame in sockets.receive_each(self.sensing):
            self.heard += 1
            self.heard_bytes += len(frame)
            sockets.send(self._displays, frame)

    def _follow_displays(self) -> None:
        for said in self._subscribers.said():
            wanted = said == _SUBSCRIBED
            if wanted != self._wanted:
                self._wanted = wanted
                self.sensing.setsockopt(zmq.SUBSCRIBE if wanted else zmq.UNSUBSCRIBE, _ALL)
