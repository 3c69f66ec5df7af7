"""A neutral listener: how many samples of each session went out, also of one that was killed."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import zmq

from protocol.wire.messages import decode_frame

POLL_MS = 20


class Witness:
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
def witness_of(address: str) -> Iterator[Witness]:
    """Who hears all that is sent at `address`, within a `with`."""
    witness = Witness()
    listener = threading.Thread(target=witness.listen, args=(address,))
    listener.start()
    try:
        yield witness
    finally:
        witness.over.set()
        listener.join()
