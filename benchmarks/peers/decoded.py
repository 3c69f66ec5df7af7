"""The smallest part of telepulse that yields a sample: wait, receive and decode, no session."""

import time
from collections.abc import Iterator

import zmq

from benchmarks.peers import curve, ours
from benchmarks.peers.message import Arrival, Wire
from protocol import sockets
from protocol.wire.messages import unpack_frame

publish = ours.publish


def subscribe(wire: Wire) -> Iterator[Arrival]:
    """Yield frames as they are decoded."""
    context: sockets.Context = zmq.Context()
    data = curve.join(sockets.unconnected(context, zmq.SUB), wire.keys)
    data.connect(ours.data_address(wire))
    data.subscribe(b"")
    descriptors = sockets.descriptors((data,))
    while True:
        for message in sockets.receive_parts(data):
            _, sequence, sent_ns, *_ = unpack_frame(message)
            yield Arrival(sequence, sent_ns, time.perf_counter_ns())
        sockets.wait_on_descriptors(descriptors, ours.WAIT_NS)
