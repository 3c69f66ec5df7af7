"""Budgets that bound what a peer can use: events per second, subscriptions, requests."""

import logging
import time
from collections import Counter
from collections.abc import Iterator, Sequence

import zmq

from protocol import sockets
from protocol.security.connection_table import shut_down

logger = logging.getLogger(__name__)

SUBSCRIPTION = "subscription"
# Bytes for subscriptions to topics of other versions.
FOREIGN_BYTES = 1_000
# Requests of a connection that are not charged.
REQUESTS_PER_S, REQUESTS_AT_ONCE = 20.0, 100.0
MAX_NAMED = 100


class TokenBucket:
    """Bound on the rate of events, with a burst above it. Pure.

    rate_per_s: tokens added per second; it may be changed. burst: greatest and initial number of
    tokens.
    """

    def __init__(self, rate_per_s: float, burst: float) -> None:
        self.rate_per_s = rate_per_s
        self._burst = self._tokens = burst
        self._now_ns = 0

    def take(self, now_ns: int, count: float = 1) -> bool:
        """Take `count` tokens and return True; if fewer are left, take none and return False."""
        earned = max(0, now_ns - self._now_ns) * (self.rate_per_s * 1e-9)
        self._tokens = min(self._burst, self._tokens + earned)
        self._now_ns = now_ns
        if count > self._tokens:
            return False
        self._tokens -= count
        return True


class SubscriptionBudget:
    """Bound on subscriptions to topics that an XPUB socket of `sockets.bind` does not publish.

    ZeroMQ stores each subscription of each peer, about 50 bytes per character, and has no option
    that bounds them. `sockets.bind` makes it read one short subscription of a connection at a time.
    Here each connection has a budget of bytes; beyond it, the connection is cut and counted in
    `rejected`. topics: published topics; b"" stands for a subscription to everything. request:
    first byte of messages that are no subscriptions, and are charged only where a connection sends
    too many; b"" for none.
    """

    def __init__(
        self, socket: sockets.Socket, topics: Sequence[bytes], request: bytes = b""
    ) -> None:
        self._socket = socket
        self._topics, self._request = list(topics), request
        self._named: set[str] = set()
        self._requests: dict[int, TokenBucket] = {}
        # Address, and used bytes of the budget, by descriptor.
        self._spent: dict[int, tuple[str, int]] = {}
        self.rejected: Counter[str] = Counter()

    def accept(self, topic: bytes) -> None:
        """Accept subscriptions to one more topic."""
        if topic not in self._topics:
            self._topics.append(topic)

    def receive(self) -> Iterator[bytes]:
        r"""Yield waiting subscriptions to and cancellations of published topics. Call it often.

        Each is XPUB's message: b"\x01" or b"\x00", then the topic. Requests are yielded, too.
        Others are charged.
        """
        for _ in range(sockets.MAX_MESSAGES):
            if not sockets.has_message(self._socket):
                return
            frame = self._socket.recv(zmq.NOBLOCK, copy=False)
            message = frame.bytes
            if self._request and message.startswith(self._request):
                wanted = self._permits(frame)
            else:
                published = any(topic.startswith(message[1:]) for topic in self._topics)
                wanted = published and message[:1] in (b"\0", b"\1")
            if wanted:
                yield message
            else:
                self._charge(frame, len(message))

    def poll(self) -> None:
        """Charge the waiting subscriptions, for a caller that does not use them."""
        for _ in self.receive():
            pass

    def _permits(self, frame: zmq.Frame) -> bool:
        try:
            descriptor = int(frame.get(zmq.SRCFD))
        except zmq.ZMQError:  # its connection has gone
            return False
        if descriptor not in self._requests:
            self._requests[descriptor] = TokenBucket(REQUESTS_PER_S, REQUESTS_AT_ONCE)
        return self._requests[descriptor].take(time.perf_counter_ns())

    def _charge(self, frame: zmq.Frame, size_bytes: int) -> None:
        try:
            descriptor = int(frame.get(zmq.SRCFD))
            address = str(frame.get("Peer-Address"))
        except zmq.ZMQError:  # ZeroMQ's own notice that a peer has gone
            return
        owner, spent_bytes = self._spent.get(descriptor, (address, 0))
        spent_bytes = size_bytes + (spent_bytes if owner == address else 0)
        self._spent[descriptor] = (address, spent_bytes)
        if spent_bytes <= FOREIGN_BYTES:
            return
        address = sockets.network_address(address)
        self.rejected[SUBSCRIPTION] += 1
        shut_down(descriptor, address)
        if address not in self._named and len(self._named) < MAX_NAMED:
            self._named.add(address)
            logger.warning(
                f"refused {address or 'a peer'}: it subscribes to topics not published here, or"
                " sends too many marks"
            )
