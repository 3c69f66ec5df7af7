"""A man in the middle of two nodes, who forwards, records and alters TCP."""

import contextlib
import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Alter = Callable[[bytes], bytes]
CHUNK_BYTES = 1 << 16
# Longer than any of a handshake's last parts that could be mistaken for a frame.
MESSAGE_BYTES = 60


class Middleman:
    """A forwarder between the clients of one port and another port.

    down, up: functions that alter the bytes to and from a client. recorded: the bytes of each
    connection, down and up.
    """

    def __init__(self, listen: int, onto: int) -> None:
        self.down: Alter | None = None
        self.up: Alter | None = None
        self.recorded: list[tuple[bytearray, bytearray]] = []
        self._onto = onto
        self._open: list[socket.socket] = []
        self._server = socket.create_server(("127.0.0.1", listen))
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self.cut()
        for thread in self._threads:
            thread.join()

    def cut(self) -> None:
        """End all connections."""
        for one in self._open:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                try:
                    server = socket.create_connection(("127.0.0.1", self._onto))
                except OSError:
                    client.close()
                    continue
                self._open += (client, server)
                self._threads.append(threading.Thread(target=self._forward, args=(client, server)))
                self._threads[-1].start()

    def _forward(self, client: socket.socket, server: socket.socket) -> None:
        """Forward one connection until either end closes it."""
        record = (bytearray(), bytearray())
        self.recorded.append(record)
        with client, server, contextlib.suppress(OSError):
            while True:
                for source in select.select([server, client], [], [])[0]:
                    upward = source is client
                    if not (data := source.recv(CHUNK_BYTES)):
                        return
                    record[upward].extend(data)
                    alter = self.up if upward else self.down
                    sink = server if upward else client
                    sink.sendall(data if alter is None else alter(data))


@contextmanager
def middleman(listen: int, onto: int) -> Iterator[Middleman]:
    between = Middleman(listen, onto)
    try:
        yield between
    finally:
        between.close()


class Once:
    """Alteration of the first chunk that is long enough to hold a message."""

    def __init__(self, alter: Alter) -> None:
        self._alter = alter
        self.done = False

    def __call__(self, data: bytes) -> bytes:
        if self.done or len(data) < MESSAGE_BYTES:
            return data
        self.done = True
        return self._alter(data)


def flip_a_bit(data: bytes) -> bytes:
    """Flip one bit in the sealed part of the last message."""
    return data[:-8] + bytes([data[-8] ^ 1]) + data[-7:]


def twice(data: bytes) -> bytes:
    return data + data
