"""ZeroMQ's own proxy between two sockets, in a thread of its own."""

import itertools
import struct
import threading
from contextlib import suppress

import zmq

from protocol import sockets

STATISTICS = struct.Struct("=Q")
# The proxy answers at once, unless the machine gives its thread no time.
ANSWER_MS = 5_000
_numbers = itertools.count()


class Proxy:
    """Passes messages between a socket for displays and one to the sensing node.

    While the proxy runs, the sockets belong to its thread; stopped, they are the caller's again.

    Attributes
    ----------
    requests, received : int
        Message parts passed to the sensing node and from it, over all runs.
    received_bytes : int
        Bytes from the sensing node.
    dropped : int
        Messages dropped because the queue to the sensing node was full.
    """

    def __init__(
        self, context: sockets.Context, displays: sockets.Socket, sensing: sockets.Socket
    ) -> None:
        # A socket that waited for room would hold up the thread for good.
        sensing.setsockopt(zmq.SNDTIMEO, 0)
        self._context = context
        self.displays = displays
        self.sensing = sensing
        self.requests = self.received = self.received_bytes = self.dropped = 0
        self._last_counts = (0, 0, 0)
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
        self._last_counts = (0, 0, 0)
        # A daemon thread cannot keep the program from ending, should it ever hang.
        self._thread = threading.Thread(target=self._run, args=(steered,), daemon=True)
        self._thread.start()

    def update_counts(self) -> None:
        """Bring the counts up to date."""
        if self._steering is None:
            return
        self._steering.send(b"STATISTICS")
        try:
            answer = self._steering.recv_multipart()
        except zmq.Again:  # counted at the next update
            return
        numbers = [number for part in answer for number in STATISTICS.unpack(part)]
        requests, received, received_bytes = numbers[0], numbers[4], numbers[5]
        # The proxy counts from zero after it had to start again.
        last = self._last_counts
        before = last if requests >= last[0] and received >= last[1] else (0, 0, 0)
        self.requests += requests - before[0]
        self.received += received - before[1]
        self.received_bytes += received_bytes - before[2]
        self._last_counts = (requests, received, received_bytes)

    def stop(self) -> None:
        """Give the sockets back; messages queued on them stay queued."""
        if self._steering is None or self._thread is None:
            return
        self.update_counts()
        self._steering.send(b"TERMINATE")
        self._thread.join()
        self._steering.close(0)
        self._steering = self._thread = None

    def _run(self, steered: sockets.Socket) -> None:
        with suppress(zmq.ContextTerminated):
            while not self._run_until_full(steered):
                pass
            steered.close(0)

    def _run_until_full(self, steered: sockets.Socket) -> bool:
        """Pass messages on until stopped (True) or until one found the queue full (False)."""
        try:
            zmq.proxy_steerable(self.displays, self.sensing, None, steered)
        except zmq.Again:
            self.dropped += 1
            # Drop the rest of that message: ZeroMQ drops whole messages or none.
            while self.displays.getsockopt(zmq.RCVMORE):
                self.displays.recv(zmq.NOBLOCK)
            return False
        return True
