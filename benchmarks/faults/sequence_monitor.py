"""A neutral listener that counts the samples of each session, also of one that was killed."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import zmq

from protocol.wire.messages import decode_frame

POLL_MS = 20


class SequenceMonitor:
    """sent: samples of each session up to the last that was heard, in the order of sessions."""

    def __init__(self) -> None:
        self.sent: dict[int, int] = {}
        self.over = threading.Event()

    def listen(self, address: str) -> None:
        """Hear frames until it is over."""
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.setsockopt(zmq.RECONNECT_IVL, POLL_MS)
            socket.subscribe(b"")
            socket.connect(address)
            while not self.over.is_set():
                if socket.poll(POLL_MS):
                    frame = decode_frame(socket.recv())
                    self.sent[frame.session] = frame.first_sample + len(frame.values)


@contextmanager
def monitor_sequence(address: str) -> Iterator[SequenceMonitor]:
    """Who hears all that is sent at `address`, within a `with`."""
    monitor = SequenceMonitor()
    listener = threading.Thread(target=monitor.listen, args=(address,))
    listener.start()
    try:
        yield monitor
    finally:
        monitor.over.set()
        listener.join()
