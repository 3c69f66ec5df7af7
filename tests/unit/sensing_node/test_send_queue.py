import zmq

from protocol.tactile import ElasticLayer
from protocol.wire.stream import Channel, StreamDescription
from sensing_node.node import MOST_BYTES, queue_limits

MS = 1_000_000


def stream(period_ns: int, batch: int, channels: int = 1) -> StreamDescription:
    names = tuple(Channel(f"c{number}") for number in range(channels))
    return StreamDescription("s", period_ns, batch, names, ElasticLayer())


def test_about_a_second_of_a_stream_may_queue() -> None:
    assert queue_limits(stream(MS, 5))[zmq.SNDHWM] == 200
    assert queue_limits(stream(MS, 1))[zmq.SNDHWM] == 1000
    assert queue_limits(stream(1_000_000_000, 1))[zmq.SNDHWM] == 16
    # The kernel doubles it; small frames cost packets of their own, of about a kilobyte.
    assert 200_000 < 2 * queue_limits(stream(MS, 5))[zmq.SNDBUF] < 250_000
    # Where a second is more than a system grants on request, the kernel chooses.
    assert zmq.SNDBUF not in queue_limits(stream(1_000, 1000, channels=8))
    assert queue_limits(stream(100_000, 50, channels=4))[zmq.SNDBUF] <= MOST_BYTES
