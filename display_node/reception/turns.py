"""Further control connections, over which a pressing display's set-points go in turns.

TCP delivers in order, so after a lost packet everything on its connection waits for the repetition:
1.25 round trips and the time to the connection's next packet. The others are not affected, and the
next set-point is on another one. In turns, n connections send as many packets as one does.
"""

from collections.abc import Iterator, Sequence

import zmq

from display_node.reception.endpoint import Endpoint
from protocol import sockets
from protocol.security.budgets import TokenBucket
from protocol.security.link_keys import ClientKeys

# A connection receives the answers to its share of the set-points and clock requests, at most 100 a
# second of all. In floods it is closed sooner than one that receives frames.
ANSWERS_PER_S, ANSWERS_AT_ONCE = 200.0, 2_000
# The sensing node forgets a connection that has been silent for 5 s.
PRESSED_NS = 2_000_000_000


class ControlTurns:
    """Connections that take turns.

    count: number of connections. endpoints: their sockets.
    """

    def __init__(self, context: sockets.Context, count: int, keys: ClientKeys | None) -> None:
        self.endpoints = [
            Endpoint(
                sockets.unconnected(context, zmq.DEALER, keys),
                TokenBucket(ANSWERS_PER_S, ANSWERS_AT_ONCE),
            )
            for _ in range(count)
        ]
        self._descriptors = sockets.descriptors(endpoint.socket for endpoint in self.endpoints)
        self._by_descriptor = dict(zip(self._descriptors.numbers, self.endpoints, strict=True))
        self._unread: set[Endpoint] = set()
        # Of each connection: time of the first message that may still be answered, and of the
        # newest set-point.
        self._asked_ns: dict[Endpoint, int] = {}
        self._pressed_ns: dict[Endpoint, int] = {}
        self._turn = 0

    def messages(self) -> Iterator[bytes]:
        """Yield the messages that wait; call it each tick.

        Only sockets whose descriptor is readable, or was before a message was sent, are read: to
        read all of them each time would take as long as the tick itself.
        """
        if not self.endpoints:
            return
        self._unread.update(self._by_descriptor[number] for number in self._descriptors.ready())
        for endpoint in list(self._unread):
            empty = True
            for message in endpoint.messages():
                empty = False
                yield message
            if empty:
                self._unread.discard(endpoint)

    def poll(self, addresses: Sequence[tuple[str, str]], answer_ns: int, now_ns: int) -> None:
        """Connect those that are not connected, or do not answer; call it each tick.

        addresses: of the sensing node, used in turns: each as the user gave it, and its control
        address. answer_ns: time allowed for the answer to a request to connect.
        """
        for number, endpoint in enumerate(self.endpoints if addresses else ()):
            if endpoint.received(now_ns):
                self._asked_ns.pop(endpoint, None)
            wanted = endpoint.address is None or not endpoint.answered or endpoint in self._asked_ns
            if wanted and endpoint.silent(now_ns):
                self._asked_ns.pop(endpoint, None)
                self._pressed_ns.pop(endpoint, None)
                endpoint.answer_ns = answer_ns
                endpoint.given, control = addresses[number % len(addresses)]
                endpoint.connect(control, now_ns, fast_retry=False)

    def next(
        self, established: set[sockets.Socket], now_ns: int, set_point: bool
    ) -> sockets.Socket | None:
        """Return the socket for a message, or None for control's.

        established: sockets with a complete connection. set_point: whether the message is one;
        others need a connection that has carried a set-point lately, by which the sensing node does
        not take it for another display.
        """
        count = len(self.endpoints)
        for _ in range(count):
            self._turn = (self._turn + 1) % count
            endpoint = self.endpoints[self._turn]
            if not endpoint.answered or endpoint.socket not in established:
                continue
            if set_point:
                self._pressed_ns[endpoint] = now_ns
            elif now_ns - self._pressed_ns.get(endpoint, -(1 << 62)) > PRESSED_NS:
                continue
            self._asked_ns.setdefault(endpoint, now_ns)
            self._unread.add(endpoint)
            return endpoint.socket
        return None
