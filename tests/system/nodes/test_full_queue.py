"""A node survives peers that fill its queue and disconnect.

With ZeroMQ's own heartbeats it would not: libzmq 4.3.5 ends the process.
"""

import time
from subprocess import PIPE

import zmq

from protocol import sockets
from protocol.host.child_process import ChildProcess
from protocol.sockets import Context

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
FLOOD = 3 * sockets.HIGH_WATER_FRAMES


def test_peers_that_disconnect_while_the_queue_is_full_do_not_end_a_node(
    context: Context, address: str
) -> None:
    with ChildProcess("node", "-c", NODE, address, stdin=PIPE, stdout=PIPE) as node:
        node.read_line(20)
        for _ in range(3):
            peer = sockets.connect(context, zmq.DEALER, address)
            peer.setsockopt(zmq.SNDTIMEO, 20_000)
            for _ in range(FLOOD):
                peer.send(bytes(1_000))
            time.sleep(0.3)
            peer.close(0)
        time.sleep(HEARTBEATS_S)
        output, _ = node.communicate("read\n", timeout=20)
    assert node.returncode == 0
    assert int(output) >= sockets.HIGH_WATER_FRAMES
