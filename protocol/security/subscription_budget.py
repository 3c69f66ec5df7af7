"""Subscriptions of a bound XPUB socket, and a budget on those to topics that are not published.

ZeroMQ keeps each subscription of each peer, some 50 bytes for each letter of it, and has no option
against that. So `sockets.bind` has it take one subscription of each connection at a time, however
many are sent, and no long ones. Here each connection has a budget; beyond it, it is cut.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import zmq

from protocol import sockets
from protocol.security.connection_table import cut
from protocol.security.zap import internet

SUBSCRIPTION = "subscription"
# What a program of another version may ask for besides, in all.
FOREIGN_BYTES = 1_000
MAX_NAMED = 100


class SubscriptionBudget:
    """The subscriptions of one XPUB socket that `sockets.bind` has bound.

    rejected: what was subscribed to beyond the budget, by cause.
    """

    def __init__(
        self, socket: sockets.Socket, topics: Sequence[bytes], log: Callable[[str], None]
    ) -> None:
        """topics: what is published; b"" stands for every topic, and is subscribed to whole."""
        self._socket = socket
        self._topics = topics
        self._log = log
        self._named: set[str] = set()
        # By descriptor: whose it is, and how much of the budget is used up.
        self._spent: dict[int, tuple[str, int]] = {}
        self.rejected: Counter[str] = Counter()

    def said(self) -> Iterator[bytes]:
        """Yield the subscriptions and cancellations of published topics since the last call.

        Each is XPUB's message: b"\\1" or b"\\0", then the topic. Call it often.
        """
        for _ in range(sockets.MAX_MESSAGES):
            if not sockets.has_message(self._socket):
                return
            frame = self._socket.recv(zmq.NOBLOCK, copy=False)
            said = frame.bytes
            if said[:1] in (b"\0", b"\1") and self._publishes(said[1:]):
                yield said
            else:
                self._charge(frame, len(said))

    def tend(self) -> None:
        """Read the subscriptions and cancellations, and charge the budget, as `said` does."""
        for _ in self.said():
            pass

    def _publishes(self, topic: bytes) -> bool:
        return any(published.startswith(topic) for published in self._topics)

    def _charge(self, frame: zmq.Frame, said_bytes: int) -> None:
        try:
            descriptor = int(frame.get(zmq.SRCFD))
            address = str(frame.get("Peer-Address"))
        except zmq.ZMQError:  # ZeroMQ's own word that a peer has gone
            return
        whose, spent_bytes = self._spent.get(descriptor, (address, 0))
        spent_bytes = said_bytes + (spent_bytes if whose == address else 0)
        self._spent[descriptor] = (address, spent_bytes)
        if spent_bytes > FOREIGN_BYTES:
            self._refuse(descriptor, internet(address))

    def _refuse(self, descriptor: int, address: str) -> None:
        self.rejected[SUBSCRIPTION] += 1
        cut(descriptor, address)
        if address not in self._named and len(self._named) < MAX_NAMED:
            self._named.add(address)
            self._log(f"refused {address or 'a peer'}: it asks for what is not published here")
