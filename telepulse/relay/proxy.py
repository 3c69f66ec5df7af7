"""ZeroMQ's own proxy between two sockets, in a thread of its own."""

import itertools
import struct
import threading
from contextlib import suppress

import zmq

from protocol import sockets

STATISTICS = struct.Struct("=Q")
# It answers at once, where the machine lets it.
ANSWER_MS = 5_000
_numbers = itertools.count()


class Proxy:
    """Passes messages between a socket for displays and one to the sensing node.

    While it runs the sockets are its thread's; stopped, they are the caller's again. Counts go on
    from one run to the next, in parts of messages: asked, towards the sensing node; heard, from it;
    and heard_bytes. dropped: messages that found the queue to the sensing node full.
    """

    def __init__(
        self, context: sockets.Context, displays: sockets.Socket, sensing: sockets.Socket
    ) -> None:
        """The sensing node's socket must not wait when it sends, or the thread would for good."""
        sensing.setsockopt(zmq.SNDTIMEO, 0)
        self._context = context
        self.displays = displays
        self.sensing = sensing
        self.asked = self.heard = self.heard_bytes = self.dropped = 0
        self._seen = (0, 0, 0)
        self._steering: sockets.Socket | None = None
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to pass messages on."""
        address = f"inproc://proxy-{next(_numbers)}"
        self._steering = self._context.socket(zmq.PAIR)
        self._steering.setsockopt(zmq.RCVTIMEO, ANSWER_MS)
        self._steering.bind(address)
        steered = self._context.socket(zmq.PAIR)
        steered.connect(address)
        self._seen = (0, 0, 0)
        # A daemon: should it ever hang, the program ends nevertheless.
        self._thread = threading.Thread(target=self._run, args=(steered,), daemon=True)
        self._thread.start()

    def look(self) -> None:
        """Bring the counts up to date."""
        if self._steering is None:
            return
        self._steering.send(b"STATISTICS")
        try:
            answer = self._steering.recv_multipart()
        except zmq.Again:  # the next look tells
            return
        numbers = [number for part in answer for number in STATISTICS.unpack(part)]
        asked, heard, heard_bytes = numbers[0], numbers[4], numbers[5]
        # It counts from zero where the thread had to begin anew.
        was = self._seen if asked >= self._seen[0] and heard >= self._seen[1] else (0, 0, 0)
        self.asked += asked - was[0]
        self.heard += heard - was[1]
        self.heard_bytes += heard_bytes - was[2]
        self._seen = (asked, heard, heard_bytes)

    def stop(self) -> None:
        """Give the sockets back. What waits on them goes on waiting."""
        if self._steering is None or self._thread is None:
            return
        self.look()
        self._steering.send(b"TERMINATE")
        self._thread.join()
        self._steering.close(0)
        self._steering = self._thread = None

    def _run(self, steered: sockets.Socket) -> None:
        with suppress(zmq.ContextTerminated):
            while not self._passed_on(steered):
                pass
            steered.close(0)

    def _passed_on(self, steered: sockets.Socket) -> bool:
        """Pass messages on until told to end, or (False) until one found the queue full."""
        try:
            zmq.proxy_steerable(self.displays, self.sensing, None, steered)
        except zmq.Again:
            self.dropped += 1
            # The rest of the message that found no room; ZeroMQ loses whole messages, or none.
            while self.displays.getsockopt(zmq.RCVMORE):
                self.displays.recv(zmq.NOBLOCK)
            return False
        return True
