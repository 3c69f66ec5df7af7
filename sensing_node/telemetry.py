"""A sensing node's telemetry: its status, once a second, for a process beside it."""

import zmq

from protocol import sockets
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.wire.telemetry import STATUS

STATUS_EVERY_NS = 1_000_000_000
MAX_READERS = 32


class Telemetry:
    """Publishes statuses. address: where; rejected: readers that were refused, by cause."""

    def __init__(self, context: sockets.Context, address: str) -> None:
        """Bind the address. Raises AddressError."""
        self._gate = Authenticator(context, None, most=MAX_READERS)
        self.rejected = self._gate.rejected
        self._socket = sockets.bind(context, zmq.XPUB, address, self._gate)
        self._readers = SubscriptionBudget(self._socket, (STATUS,))
        self._next_ns = 0
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def due(self, now_ns: int) -> bool:
        """Whether it is time for a status; call it often."""
        self._gate.poll(now_ns)
        self._readers.poll()
        if now_ns < self._next_ns:
            return False
        self._next_ns = now_ns + STATUS_EVERY_NS
        return True

    def publish(self, status: bytes) -> None:
        """Publish a status."""
        sockets.send(self._socket, STATUS, status)
