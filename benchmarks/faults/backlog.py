"""Amount of a stream that queues for a display that never reads, with and without our limits."""

import time
from collections.abc import Mapping

import zmq

from benchmarks.benchmark import Benchmark
from protocol import sockets
from protocol.tactile import ElasticLayer
from protocol.wire.messages import HEADER_BYTES
from protocol.wire.stream import Channel, StreamDescription
from sensing_node.node import queue_limits
from tests.support.hostile_peers import deaf_subscriber, port_of

FRAME_S = 5e-3
SAMPLES = (5, 50, 250, 4000)
FULL_AFTER_S = 1.0
# The kernel's own timeout for a peer that does not read.
NO_LIMITS: dict[int, int] = {zmq.TCP_MAXRT: 0}


def backlogs(benchmark: Benchmark) -> None:
    """Print the table."""
    benchmark.table(
        f"Queue for a display that never reads, frames of {FRAME_S * 1e3:g} ms, in s of the"
        " stream and in MB: by default (1000 frames and the kernel's buffers), and with our limits",
        ("samples a frame", "s", "MB", "s, limited", "MB, limited"),
        [row(samples) for samples in SAMPLES],
    )


def row(samples: int) -> tuple[str, ...]:
    """Return the table's row for frames of `samples` samples."""
    period_ns = round(FRAME_S * 1e9 / samples)
    stream = StreamDescription("s", period_ns, samples, (Channel("c"),), ElasticLayer())
    frame = bytes(HEADER_BYTES + samples * stream.bytes_per_sample)
    cells = [str(samples)]
    for options in (NO_LIMITS, queue_limits(stream)):
        frames = queued(frame, options)
        cells += [f"{frames * FRAME_S:.1f}", f"{frames * len(frame) * 1e-6:.2f}"]
    return tuple(cells)


def queued(frame: bytes, options: Mapping[int, int]) -> int:
    """Return the number of frames that a publisher accepts.

    They are sent so slowly that the kernel does not join them.
    """
    context: sockets.Context = zmq.Context()
    # With this option the publisher reports a full queue instead of dropping frames.
    options = {**options, zmq.XPUB_NODROP: 1}
    publisher = sockets.bind(context, zmq.XPUB, "tcp://127.0.0.1:*", limits=options)
    port = port_of(publisher.getsockopt_string(zmq.LAST_ENDPOINT))
    frames, accepted_s = 0, time.monotonic()
    with deaf_subscriber(port, small=False):
        publisher.recv()
        while time.monotonic() < accepted_s + FULL_AFTER_S:
            if sockets.send(publisher, frame):
                frames, accepted_s = frames + 1, time.monotonic()
            time.sleep(1e-4)
    context.destroy(linger=0)
    return frames
