"""How much may queue for a display that does not read: about a second of the stream.

What queues beyond that is older than anybody could feel it
([decision 22](../docs/decisions/0022-a-backlog-is-bounded-by-time.md)).
"""

import math

import zmq

from protocol.wire.stream import StreamDescription

BACKLOG_NS = 1_000_000_000
LEAST_FRAMES = 16
# What a frame costs besides its samples: as a message, and as a packet that is under way.
HEADER_BYTES = 50
PACKET_BYTES = 1_024
# Linux takes no more than this, unless it is told to, and gives a socket twice as much. Left to
# itself it gives up to 4 MB, which is right for streams that need more.
MOST_BYTES = 212_992


def limits(description: StreamDescription) -> dict[int, int]:
    """Socket options that bound what queues for each display."""
    frames = BACKLOG_NS / (description.batch * description.period_ns)
    values = description.batch * len(description.channels)
    frame_bytes = HEADER_BYTES + PACKET_BYTES + values * description.bytes_per_sample
    options: dict[int, int] = {zmq.SNDHWM: max(LEAST_FRAMES, math.ceil(frames))}
    kernel_bytes = math.ceil(max(frames, LEAST_FRAMES) * frame_bytes / 2)
    if kernel_bytes <= MOST_BYTES:
        options[zmq.SNDBUF] = kernel_bytes
    return options
