"""One socket to the sensing node, and the times at which it is connected anew."""

from collections.abc import Iterator

from display_node.reception.timeouts import ANSWER_NS, answer_timeout_ns, patience_ns
from protocol import sockets
from protocol.security.budgets import TokenBucket

# Ten unanswered requests to connect are repeated early. Then one is left for this time to the
# kernel, which repeats it after 1 s: the network may have become slower.
FAST_RETRIES, UNHURRIED_NS = 10, 3_000_000_000
# A hostile peer may send any number of messages. After a stall of the display, some 5 000 queued
# frames come at once (docs/decisions/0022). At 10 to 20 µs each, the highest sustained rate takes a
# tenth of a core. Above it, the connection is closed for a while.
BURST = 10_000
LEAST_PER_S, MOST_PER_S = 1_000.0, 5_000.0
FLOODED_NS = 5_000_000_000
# Long messages cost more: one token, and one more for each such part.
BYTES_PER_TOKEN = 4_096


class Endpoint:
    """A socket that is connected to one address at a time.

    budget: of the messages that it receives. address: the present one; None while it is not
    connected. given: of a control endpoint, the sensing node's address as the user gave it.
    answer_ns: time after which an unanswered request to connect is repeated. asked_ns, answered:
    time of the present request, and whether a host has answered it.
    """

    def __init__(self, socket: sockets.Socket, budget: TokenBucket | None = None) -> None:
        self.socket = socket
        self.address: str | None = None
        self.given = ""
        self.answer_ns = ANSWER_NS
        self.asked_ns = 0
        self.answered = False
        self._tries = 0
        self._received = 0
        self._silent_ns = self._closed_until_ns = 0
        self._budget = budget or TokenBucket(LEAST_PER_S, BURST)
        self._spent = 0

    def messages(self) -> Iterator[bytes]:
        """Yield the messages that wait."""
        for message in sockets.receive_parts(self.socket):
            self._received += 1
            self._spent += 1 + len(message) // BYTES_PER_TOKEN
            yield message

    def expect(self, messages_per_s: float) -> None:
        """Permit twice this rate of messages, within the least and the highest rate."""
        self._budget.rate_per_s = min(MOST_PER_S, max(LEAST_PER_S, 2 * messages_per_s))

    def flooded(self, now_ns: int) -> bool:
        """Return whether more messages have come than is permitted; call it each tick."""
        spent, self._spent = self._spent, 0
        return spent > 0 and not self._budget.take(now_ns, spent)

    def received(self, now_ns: int) -> int:
        """Return the number of messages since the last call."""
        received, self._received = self._received, 0
        if received:
            self._tries = 0
            self._silent_ns = now_ns + patience_ns(self.answer_ns)
        return received

    def answer(self, now_ns: int) -> None:
        """Note that a host has answered the request to connect; its time bounds the round trip."""
        if self.answered:
            return
        self.answered = True
        self.answer_ns = max(self.answer_ns, answer_timeout_ns(now_ns - self.asked_ns))
        self._silent_ns = now_ns + patience_ns(self.answer_ns)

    def close(self, until_ns: int) -> int:
        """Disconnect, and stay closed until a time; return the number of dropped messages."""
        self._closed_until_ns = until_ns
        return self.disconnect()

    def closed(self, now_ns: int) -> bool:
        """Return whether `close` is still in effect."""
        return now_ns < self._closed_until_ns

    def silent(self, now_ns: int) -> bool:
        """Return whether it is not connected, or has received nothing for too long."""
        if self.closed(now_ns):
            return False
        return self.address is None or now_ns >= self._silent_ns

    def connect(self, address: str, now_ns: int, fast_retry: bool = True) -> None:
        """Connect to `address` instead of the one before; the two may be the same.

        fast_retry: repeat the request to connect after `answer_ns`, unless `FAST_RETRIES` are used
        up.
        """
        fast_retry = fast_retry and self._tries % (FAST_RETRIES + 1) < FAST_RETRIES
        self._tries += 1
        self.asked_ns, self.answered = now_ns, False
        sockets.reconnect(self.socket, self.address, address, self.answer_ns if fast_retry else 0)
        self.address = address
        self._silent_ns = now_ns + (patience_ns(self.answer_ns) if fast_retry else UNHURRIED_NS)

    def disconnect(self) -> int:
        """Close the connection; return how many queued messages were dropped."""
        if self.address is not None:
            sockets.disconnect(self.socket, self.address)
        self.address, self.answered, self._received = None, False, 0
        return self.drop()

    def drop(self) -> int:
        """Drop queued messages, and let ZeroMQ finish closing; return the number dropped."""
        return sum(1 for _ in sockets.receive_parts(self.socket))
