"""More displays than a sensing node serves."""

import signal

import zmq

from protocol.sockets import Context, control_address
from protocol.wire.messages import Bye, ClockReply, ClockRequest, Hello, Welcome, decode_control
from protocol.wire.messages import encode_control as encode
from sensing_node.control_server import MAX_CLIENTS
from tests.support.log_lines import strays
from tests.support.nodes import RADIAL, free_address, process
from tests.support.sensing_client import PATIENCE_MS

TOO_MANY = 5


def test_a_full_node_answers_its_displays_and_no_further_one(context: Context) -> None:
    address = free_address()
    # A relay passes on an address before the message of each display.
    relay = context.socket(zmq.DEALER)
    relay.setsockopt(zmq.RCVTIMEO, PATIENCE_MS)
    relay.connect(control_address(address))
    with process("sensing_node.cli", str(RADIAL), "--bind", address) as node:
        for number in range(MAX_CLIENTS + TOO_MANY):
            display = b"\0%04d" % number
            relay.send_multipart([display, encode(Hello(f"display {number}"))])
            if number >= MAX_CLIENTS:
                continue
            sender, welcome = relay.recv_multipart()
            assert sender == display
            message = decode_control(welcome)
            assert isinstance(message, Welcome)
            # The node does not wait for it at the end.
            relay.send_multipart([sender, encode(Bye(message.session, 0))])
        relay.send_multipart([b"\0%04d" % 0, encode(ClockRequest(7))])
        sender, reply = relay.recv_multipart()
        assert sender == b"\0%04d" % 0
        assert isinstance(decode_control(reply), ClockReply)
        node.send_signal(signal.SIGTERM)
        output, errors = node.communicate(timeout=PATIENCE_MS / 1000)
    assert (node.returncode, strays(errors)) == (0, "")
    assert errors.count("no further one is answered") == 1
    assert f"{TOO_MANY} too_many_displays" in output
