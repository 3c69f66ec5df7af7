import zmq

from protocol.wire.stream import Channel
from sensing_node.node import MOST_BYTES, queue_limits
from tests.support.streams import MS, description


def limits(period_ns: int, batch: int, channels: int = 1) -> dict[int, int]:
    names = tuple(Channel(f"c{number}") for number in range(channels))
    return queue_limits(description(period_ns=period_ns, batch=batch, channels=names))


def test_a_queue_holds_about_a_second_of_the_stream() -> None:
    assert limits(MS, 5)[zmq.SNDHWM] == 200
    assert limits(MS, 1)[zmq.SNDHWM] == 1000
    assert limits(1_000_000_000, 1)[zmq.SNDHWM] == 16
    # The kernel doubles the size; each small frame needs a packet of about a kilobyte.
    assert 200_000 < 2 * limits(MS, 5)[zmq.SNDBUF] < 250_000
    # Where a second needs more than Linux accepts, the kernel chooses.
    assert zmq.SNDBUF not in limits(1_000, 1000, channels=8)
    assert limits(100_000, 50, channels=4)[zmq.SNDBUF] <= MOST_BYTES
