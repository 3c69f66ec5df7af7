"""A sensing node's stream as blocks of numpy arrays, received in a thread of its own."""

import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Final

import zmq

from display_node.reception.connection import Connection
from display_node.reception.link_delay import LATE_TARGET
from display_node.reception.receiver import Receiver
from protocol import sockets
from protocol.config.arguments import file_path, number, whole_number
from protocol.config.quantities import shown
from protocol.errors import AddressError, SourceError, WireError
from protocol.security.link_keys import ClientKeys, KeyOptions
from protocol.wire.description import StreamDescription
from protocol.wire.messages import Welcome, decode_control, encode_control, with_array
from telepulse.sample_queue import SampleQueue, StreamBlock

POLL_NS: Final = 5_000_000
MOST_SAMPLES: Final = (1 << 63) - 1


class LiveStream(AbstractContextManager["LiveStream"]):
    """A live stream of a sensing node; `connect` makes one.

    It receives in a thread, so that nothing is missed while a notebook computes. `KEPT_S` seconds
    are kept for `read`.
    """

    def __init__(self, address: str, keys: ClientKeys | None) -> None:
        self.address = address
        self._name = f"python-{uuid.uuid4().hex[:6]}"
        self._receiver = Receiver(self._name, [0], LATE_TARGET)
        self._queue, self._changed = SampleQueue(), threading.Condition()
        self._description: StreamDescription | None = None
        self._ended, self._stopping = False, False
        self._unix_minus_local_ns = time.time_ns() - time.perf_counter_ns()
        self._error: Exception | None = None
        self._context: sockets.Context = zmq.Context()
        try:
            self._connection = Connection(self._context, [address], 1, keys)
        except BaseException:
            self._context.destroy(linger=0)
            raise
        self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the connection; it may be called again."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join()

    @property
    def lost(self) -> int:
        """Number of samples that did not arrive, so far."""
        return self._queue.lost

    @property
    def dropped(self) -> int:
        """Number of samples that were not read within `KEPT_S`."""
        return self._queue.dropped

    def describe(self, timeout_s: float = 10.0) -> StreamDescription:
        """Return the stream's description: name, period, channels with their units, layer.

        Raises
        ------
        SourceError
            If no sensing node has answered for `timeout_s`, in s.
        """
        with self._changed:
            self._await(lambda: self._description is not None, timeout_s)
            assert self._description is not None
            return self._description

    def read(self, count: int, timeout_s: float = 10.0) -> StreamBlock:
        """Return the next `count` samples, once they have arrived.

        Parameters
        ----------
        count
            Number of samples, at least 1. The block is shorter where a session ends.
        timeout_s
            Longest time without a new sample, in s.

        Raises
        ------
        ArgumentError
            If `count` or `timeout_s` is no number, or out of range.
        SourceError
            If no sample came for `timeout_s`, the stream has ended or was closed, or it cannot be
            received.
        """
        block = self._next(count, timeout_s)
        if block is None:
            raise SourceError(f"{self.address}: the stream has ended")
        return block

    def blocks(self, count: int, timeout_s: float = 10.0) -> Iterator[StreamBlock]:
        """Yield blocks of `count` samples until the stream ends; raises as `read` does."""
        while (block := self._next(count, timeout_s)) is not None:
            yield block

    def _next(self, count: int, timeout_s: float) -> StreamBlock | None:
        count = whole_number("count", count, 1, MOST_SAMPLES)
        queue = self._queue
        with self._changed:
            while queue.waiting < count and not queue.session_ends and not self._ended:
                self._await(partial(self._more_than, queue.waiting), timeout_s)
            return queue.take(count)

    def _more_than(self, waiting: int) -> bool:
        return self._queue.waiting > waiting or self._ended

    def _await(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait for a change. Raises SourceError, and ArgumentError for a time that is none."""
        timeout_s = number("timeout_s", timeout_s, 0, threading.TIMEOUT_MAX)
        self._changed.wait_for(lambda: condition() or self._stopping or self._error, timeout_s)
        if self._error is not None:
            raise SourceError(f"{self.address}: cannot be received: {self._error}")
        if condition():
            return
        if self._stopping:
            raise SourceError(f"{self.address}: this stream was closed")
        raise SourceError(f"{self.address}: no sample came for {timeout_s:g} s")

    def _run(self) -> None:
        try:
            while not self._stopping:
                sockets.wait_on_descriptors(self._connection.descriptors, POLL_NS)
                with self._changed:
                    self._poll()
                    self._changed.notify_all()
            if (leaving := self._receiver.leave()) is not None:
                sockets.send(self._connection.control.socket, encode_control(leaving))
        except Exception as error:  # Raised again where the stream is read.
            with self._changed:
                self._error = error
                self._changed.notify_all()
        finally:
            self._connection.close()
            self._context.destroy(linger=sockets.LINGER_MS)

    def _poll(self) -> None:
        connection = self._connection
        for data in connection.control.messages():
            self._take_control(data)
        for data in connection.routes[0].messages():
            self._take_frame(data)
        receiver, now_ns = self._receiver, time.perf_counter_ns()
        description = receiver.description
        if receiver.accepts_frames and description is not None:
            frame_ns = description.batch * description.period_ns
            connection.subscribe(frame_ns, 2 * receiver.clock.asymmetry_bound_ns, now_ns)
        if connection.poll(now_ns):
            receiver.introduce()
        for message in receiver.requests(now_ns):
            sockets.send(connection.control.socket, encode_control(message))
        if receiver.buffer.newest_ns is not None:
            # The arrays are the only consumer: the receiver's own buffer need keep nothing.
            receiver.buffer.advance(receiver.buffer.newest_ns)
        if receiver.over(now_ns, 0) and not self._ended:
            self._queue.flush(self._ahead_ns(now_ns))
            self._ended = True

    def _take_control(self, data: bytes) -> None:
        """Take a control message; the first description decides what the receiver plays."""
        now_ns = time.perf_counter_ns()
        if self._receiver.session is None:
            try:
                message = decode_control(data)
            except WireError:
                message = None
            if isinstance(message, Welcome):
                forces = [
                    n for n, each in enumerate(message.description.channels) if each.unit == "N"
                ]
                self._receiver = Receiver(self._name, forces[:1] or [0], LATE_TARGET)
        self._receiver.on_control(data, now_ns)
        if self._receiver.other_version:
            raise WireError("version", self._receiver.other_version)
        self._description = self._receiver.description
        if self._ended and not self._receiver.buffer.ended:
            self._ended = False

    def _take_frame(self, data: bytes) -> None:
        receiver, now_ns = self._receiver, time.perf_counter_ns()
        if receiver.on_frame(data, now_ns) is not None and receiver.frame is not None:
            self._queue.add(with_array(receiver.frame), now_ns, self._ahead_ns(now_ns))

    def _ahead_ns(self, now_ns: int) -> int:
        """Return the sensing clock minus Unix time."""
        if not self._receiver.clock.ready:
            return 0
        return self._receiver.clock.offset_ns(now_ns) - self._unix_minus_local_ns


def connect(
    address: str,
    key: Path | str | None = None,
    peer: Path | str | None = None,
    insecure: bool = False,
) -> LiveStream:
    """Connect to a sensing node, and receive its stream as blocks of numpy arrays.

    Parameters
    ----------
    address
        Address of the sensing node, `tcp://HOST:PORT`.
    key, peer
        Files of this program's secret key and of the sensing node's public key (`telepulse keys`).
        Required for a node on another machine.
    insecure
        Whether to connect to another machine without keys.

    Returns
    -------
    LiveStream
        Use it in a `with`, or close it.

    Raises
    ------
    AddressError
        If the address is not one.
    ArgumentError
        If `key` or `peer` is no path.
    ProtectionError, KeyFileError
        If keys are required, or cannot be read.

    Examples
    --------
    >>> with telepulse.connect("tcp://127.0.0.1:5555") as stream:  # doctest: +SKIP
    ...     block = stream.read(1000)
    ...     print(block.values.mean(axis=0))
    """
    if not isinstance(address, str):
        raise AddressError(f"address: must be a text tcp://HOST:PORT, got {shown(address)}")
    keys = KeyOptions(
        None if key is None else file_path("key", key),
        None if peer is None else file_path("peer", peer),
        insecure=insecure,
    )
    return LiveStream(address, keys.client(address))
