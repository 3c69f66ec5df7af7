"""Sockets of the nodes, and free addresses for tests."""

import time
from collections.abc import Callable, Iterator
from subprocess import PIPE

import pytest
import zmq

from protocol import sockets
from protocol.host.child_process import ChildProcess
from protocol.sockets import MAX_MESSAGES, Context, Socket
from protocol.wire.messages import MAX_FRAME_BYTES

# Longer than any test may take: pytest's timeout ends a test that waits in vain.
FOREVER_NS = 3_600_000_000_000
LOOPBACK = "tcp://127.0.0.1:*"

pytestmark = pytest.mark.timeout(30)


def endpoint(socket: Socket) -> str:
    return str(socket.getsockopt_string(zmq.LAST_ENDPOINT))


def received(socket: Socket) -> list[list[bytes]]:
    """Return the messages that wait, each with its parts."""
    return list(sockets.receive_multipart(socket))


def pair(context: Context, address: str = "inproc://pair") -> tuple[Socket, Socket]:
    bound = sockets.bind(context, zmq.PAIR, address)
    return bound, sockets.connect(context, zmq.PAIR, endpoint(bound))


@pytest.mark.parametrize(
    ("receive", "expected"),
    [
        (sockets.receive_multipart, [[b"first", b"", b"third"], [b"alone"]]),
        (sockets.receive_parts, [b"first", b"", b"third", b"alone"]),
    ],
)
def test_messages_are_received_with_their_parts_and_a_bounded_number_at_once(
    receive: Callable[[Socket], Iterator[object]], expected: list[object], context: Context
) -> None:
    one, other = pair(context)
    assert list(receive(one)) == list(receive(other)) == []
    assert sockets.send(one, b"first", b"", b"third")
    assert sockets.send(one, b"alone")
    assert list(receive(other)) == expected
    assert all(sockets.send(one, b"x") for _ in range(2 * MAX_MESSAGES + 5))
    assert [len(list(receive(other))) for _ in range(4)] == [MAX_MESSAGES, MAX_MESSAGES, 5, 0]


def test_wait_on_descriptors_sees_each_message_of_a_drained_socket(context: Context) -> None:
    one, other = pair(context, LOOPBACK)
    waited_for = sockets.descriptors([other])
    for number in range(200):
        while not sockets.send(one, b"%d" % number):
            sockets.wait_readable([one], 1_000_000)
        while not (received := list(sockets.receive_parts(other))):
            assert sockets.wait_on_descriptors(waited_for, FOREVER_NS)
        assert received == [b"%d" % number]
    assert not sockets.wait_on_descriptors(waited_for, 1_000_000)


def test_a_wait_ends_at_a_message_on_any_socket_and_at_those_that_a_bounded_read_left(
    context: Context,
) -> None:
    pairs = [pair(context, f"inproc://{name}") for name in "abc"]
    readable = [other for _, other in pairs]
    for one, other in pairs:
        for _ in range(MAX_MESSAGES + 1):
            sockets.send(one, b"x")
        for count in (MAX_MESSAGES, 1):
            sockets.wait_readable(readable, FOREVER_NS)
            assert received(other) == [[b"x"]] * count


def test_a_wait_ends_at_a_message_that_arrived_before_one_was_sent(context: Context) -> None:
    one, other = pair(context)
    sockets.send(other, b"open")
    assert received(one) == [[b"open"]]
    sockets.send(one, b"x")
    # Sending also handles what has arrived: the descriptor shows nothing new after it.
    sockets.send(other, b"y")
    sockets.wait_readable([other], FOREVER_NS)
    assert received(other) == [[b"x"]]


def test_a_message_above_the_size_limit_ends_the_connection(context: Context) -> None:
    one, other = pair(context, LOOPBACK)
    largest = bytes(4 * MAX_FRAME_BYTES)
    while not sockets.send(one, largest):
        sockets.wait_readable([one], 1_000_000)
    sockets.wait_readable([other], FOREVER_NS)
    assert received(other) == [[largest]]
    monitor = other.get_monitor_socket(zmq.EVENT_DISCONNECTED)
    assert sockets.send(one, largest + b"\0")
    assert monitor.poll(10_000)
    assert received(other) == []


# It reads nothing for longer than two heartbeats.
NODE = """
import sys, time, zmq
from protocol import sockets
context = zmq.Context()
node = sockets.bind(context, zmq.ROUTER, sys.argv[1])
print("bound", flush=True)
sys.stdin.readline()
print(sum(1 for _ in range(100) for _ in sockets.receive_multipart(node)))
context.destroy(0)
"""
HEARTBEATS_S = 4.5


def test_peers_that_disconnect_while_the_queue_is_full_do_not_end_a_node(
    context: Context, address: str
) -> None:
    """With ZeroMQ's own heartbeats libzmq 4.3.5 would end the process."""
    with ChildProcess("node", "-c", NODE, address, stdin=PIPE, stdout=PIPE) as node:
        node.read_line(20)
        for _ in range(3):
            peer = sockets.connect(context, zmq.DEALER, address)
            peer.setsockopt(zmq.SNDTIMEO, 20_000)
            for _ in range(3 * sockets.HIGH_WATER_FRAMES):
                peer.send(bytes(1_000))
            time.sleep(0.3)
            peer.close(0)
        time.sleep(HEARTBEATS_S)
        output, _ = node.communicate("read\n", timeout=20)
    assert node.returncode == 0
    assert int(output) >= sockets.HIGH_WATER_FRAMES
