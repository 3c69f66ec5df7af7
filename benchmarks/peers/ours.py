"""telepulse: a frame through its sockets and session until it is in the jitter buffer."""

import time
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import zmq

from benchmarks.peers.message import VALUE, Arrival, Wire, join, serve
from display_node.reception.jitter_buffer import JitterBuffer
from display_node.reception.receiver import Receiver
from protocol import sockets
from protocol.tactile import ElasticLayer
from protocol.wire.description import Channel, StreamDescription
from protocol.wire.messages import Frame, decode_flat_frame, encode_control, encode_frame
from sensing_node.control_server import ControlServer

SESSION = 1
PERIOD_NS = 1_000_000
DESCRIPTION = StreamDescription("peer", PERIOD_NS, 1, (Channel("pulse"),), ElasticLayer())
LATE_TARGET = 0.01
# Longest wait, by which requests may be sent late.
WAIT_NS = 10_000_000


def publish(wire: Wire, numbers: Iterable[int]) -> None:
    """Answer the display and send a frame for each number, with the time before encoding."""
    context: sockets.Context = zmq.Context()
    data = serve(sockets.unconnected(context, zmq.PUB), wire.keys)
    control = serve(sockets.unconnected(context, zmq.ROUTER), wire.keys)
    data.bind(data_address(wire))
    control.bind(sockets.control_address(data_address(wire)))
    desk = ControlServer(DESCRIPTION, SESSION)
    values = np.full((1, 1), VALUE, np.float32)
    for sequence in numbers:
        for *sender, message in sockets.receive_multipart(control):
            reply = desk.answer(tuple(sender), message, time.perf_counter_ns(), sequence)
            if reply is not None:
                sockets.send(control, *sender, encode_control(reply))
        frame = Frame(SESSION, sequence, time.perf_counter_ns(), PERIOD_NS, values)
        sockets.send(data, encode_frame(frame))


def stamped_buffer() -> tuple[JitterBuffer, list[int]]:
    """Return a jitter buffer and the time, by CLOCK_MONOTONIC, when the last frame was in it."""
    put_ns: list[int] = []
    buffer = JitterBuffer()
    put = buffer.put

    # A function in place of the method, since a class with `super` would add to the latency.
    def stamped(
        first_sample: int,
        period_ns: int,
        times_ns: list[int],
        forces_n: Sequence[Sequence[float]],
    ) -> None:
        put(first_sample, period_ns, times_ns, forces_n)
        put_ns[:] = [time.perf_counter_ns()]

    buffer.put = stamped  # type: ignore[method-assign]
    return buffer, put_ns


def subscribe(wire: Wire) -> Iterator[Arrival]:
    """Yield frames as they are in the buffer, by the loop of `DisplayNode` without ticks."""
    context: sockets.Context = zmq.Context()
    data = join(sockets.unconnected(context, zmq.SUB), wire.keys)
    control = join(sockets.unconnected(context, zmq.DEALER), wire.keys)
    data.connect(data_address(wire))
    control.connect(sockets.control_address(data_address(wire)))
    receiver = Receiver("peer", channels=[0], late_target=LATE_TARGET)
    buffer, put_ns = stamped_buffer()
    descriptors = sockets.descriptors((control, data))
    while True:
        for message in sockets.receive_parts(data):
            samples = receiver.on_frame(message, time.perf_counter_ns())
            if samples is not None:
                usable_ns = put_ns[0] if put_ns else time.perf_counter_ns()
                yield Arrival(samples[0].first_sample, samples[0].times_ns[0], usable_ns)
        for message in sockets.receive_parts(control):
            receiver.on_control(message, time.perf_counter_ns())
        if receiver.accepts_frames and receiver.buffer is not buffer:
            receiver.buffer = buffer
            data.subscribe(b"")
        requests = receiver.requests(time.perf_counter_ns())
        for request in requests:
            sockets.send(control, encode_control(request))
        if not requests:
            sockets.wait_on_descriptors(descriptors, WAIT_NS)


def subscribe_decoded(wire: Wire) -> Iterator[Arrival]:
    """Yield frames as they are decoded: the smallest part that yields a sample, no session."""
    context: sockets.Context = zmq.Context()
    data = join(sockets.unconnected(context, zmq.SUB), wire.keys)
    data.connect(data_address(wire))
    data.subscribe(b"")
    descriptors = sockets.descriptors((data,))
    while True:
        for message in sockets.receive_parts(data):
            _, sequence, times_ns, *_ = decode_flat_frame(message)
            yield Arrival(sequence, times_ns[0], time.perf_counter_ns())
        sockets.wait_on_descriptors(descriptors, WAIT_NS)


def data_address(wire: Wire) -> str:
    """Return the address of the sensing node; its control is one port higher."""
    return f"tcp://127.0.0.1:{wire.port}"
