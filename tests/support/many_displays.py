"""`python -m tests.support.many_displays ADDRESS COUNT`: many displays in one process.

Each has its own sockets, follows session, clock and stream as every display does, and counts its
samples. It drives no actuator: that would take a core for every ten displays. After the end of the
stream the program prints a line of JSON: the samples sent, played, predicted, late, lost and
before joining of each display.
"""

import json
import sys
import time

import zmq

from display_node.reception.receiver import Receiver
from protocol import sockets
from protocol.wire.messages import encode_control

POLL_MS = 5
# From a sample's instant until its playback is over. It is not felt, so this may be generous.
PLAYED_AFTER_NS = 200_000_000


class Listener:
    """The receiving part of one display."""

    def __init__(self, context: sockets.Context, address: str, name: str) -> None:
        control = sockets.control_address(address)
        self.control = sockets.connect(context, zmq.DEALER, control)
        self.data = sockets.connect(context, zmq.SUB, address)
        self.receiver = Receiver(name, channels=[0], late_target=0.01)
        self._subscribed = False

    def poll(self, now_ns: int) -> None:
        """Process what has arrived, and send due requests."""
        receiver = self.receiver
        for message in sockets.receive_parts(self.control):
            receiver.on_control(message, time.perf_counter_ns())
        for message in sockets.receive_parts(self.data):
            receiver.on_frame(message, time.perf_counter_ns())
        for request in receiver.requests(now_ns):
            sockets.send(self.control, encode_control(request))
        if receiver.accepts_frames:
            if not self._subscribed:
                self.data.subscribe(b"")
                self._subscribed = True
            receiver.buffer.advance(receiver.clock.remote_ns(now_ns) - PLAYED_AFTER_NS)

    @property
    def over(self) -> bool:
        buffer, now_ns = self.receiver.buffer, time.perf_counter_ns()
        return buffer.ended and self.receiver.over(now_ns, PLAYED_AFTER_NS)


def main() -> None:
    address, count = sys.argv[1], int(sys.argv[2])
    context: sockets.Context = zmq.Context()
    displays = [Listener(context, address, f"displays-{number}") for number in range(count)]
    poller = zmq.Poller()
    for listener in displays:
        poller.register(listener.data, zmq.POLLIN)
        poller.register(listener.control, zmq.POLLIN)
    print("listening", flush=True)
    while not all(listener.over for listener in displays):
        poller.poll(POLL_MS)
        now_ns = time.perf_counter_ns()
        for listener in displays:
            listener.poll(now_ns)
    accounts = [listener.receiver.account() for listener in displays]
    print(
        json.dumps(
            [[a.sent, a.played, a.predicted, a.late, a.lost, a.before_joining] for a in accounts]
        )
    )
    context.destroy(linger=sockets.LINGER_MS)


if __name__ == "__main__":
    main()
