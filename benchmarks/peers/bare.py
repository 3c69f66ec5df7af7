"""pyzmq and msgpack alone: PUB to SUB, one blocking receive for each message."""

import time
from collections.abc import Iterable, Iterator

import msgpack
import zmq

from benchmarks.peers import curve
from benchmarks.peers.message import VALUE, Arrival, Wire
from protocol.sockets import Context


def publish(wire: Wire, numbers: Iterable[int]) -> None:
    """Send a message for each number."""
    context: Context = zmq.Context()
    socket = curve.serve(context.socket(zmq.PUB), wire.keys)
    socket.bind(f"tcp://127.0.0.1:{wire.port}")
    pack = msgpack.Packer().pack
    for sequence in numbers:
        socket.send(pack((sequence, time.perf_counter_ns(), VALUE)))


def subscribe(wire: Wire) -> Iterator[Arrival]:
    """Yield messages as they arrive."""
    context: Context = zmq.Context()
    socket = curve.join(context.socket(zmq.SUB), wire.keys)
    socket.subscribe(b"")
    socket.connect(f"tcp://127.0.0.1:{wire.port}")
    while True:
        sequence, sent_ns, _ = msgpack.unpackb(socket.recv())
        yield Arrival(sequence, sent_ns, time.perf_counter_ns())
