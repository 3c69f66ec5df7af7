"""One socket to the sensing node, and when to connect it anew."""

from collections.abc import Iterator, Sequence

from protocol import sockets
from protocol.security.budgets import TokenBucket

PATIENCE_NS = 2_000_000_000
# How long to wait for the answer to a request to connect. The network may be slower than it was:
# ten requests are repeated early, then one is given all the time that it takes.
ANSWER_NS = 100_000_000
FAST_RETRIES = 10
# A hostile peer may send any number of messages. What has queued for a display that stood still
# comes in at once: some 5 000 frames (docs/decisions/0022). At 10 to 20 µs each, the most that is
# read in the long run takes a tenth of a core. Beyond it, the connection is closed for a while.
BURST = 10_000
LEAST_PER_S, MOST_PER_S = 1_000.0, 5_000.0
FLOODED_NS = 5_000_000_000
# Long messages cost more.
BYTES_PER_TOKEN = 4_096


class Endpoint:
    """A socket that is connected to one address at a time.

    Attributes
    ----------
    address
        What it is connected to; None while it is not.
    answer_ns
        Time in ns after which a request to connect that nobody answers is repeated.
    asked_ns, answered
        When the present request was made, and whether a host has answered it.
    """

    def __init__(self, socket: sockets.Socket) -> None:
        self.socket = socket
        self.address: str | None = None
        self.answer_ns = ANSWER_NS
        self.asked_ns = 0
        self.answered = False
        self._tries = 0
        self._received = 0
        self._silent_ns = self._closed_until_ns = 0
        self._budget = TokenBucket(LEAST_PER_S, BURST)
        self._spent = 0

    def messages(self) -> Iterator[bytes]:
        """Yield the messages that wait."""
        for message in sockets.receive_each(self.socket):
            self._received += 1
            self._spent += 1 + len(message) // BYTES_PER_TOKEN
            yield message

    def expect(self, messages_per_s: float) -> None:
        """Allow for twice so many messages a second."""
        self._budget.change_rate(min(MOST_PER_S, max(LEAST_PER_S, 2 * messages_per_s)))

    def flooded(self, now_ns: int) -> bool:
        """Return whether more has come than is allowed; call it each tick."""
        spent, self._spent = self._spent, 0
        return spent > 0 and not self._budget.take(now_ns, spent)

    def received(self, now_ns: int) -> int:
        """Return how many messages have come since this was called last."""
        received, self._received = self._received, 0
        if received:
            self._tries = 0
            self._silent_ns = now_ns + PATIENCE_NS
        return received

    def close(self, until_ns: int) -> int:
        """Disconnect, and stay so until then; return how many messages were dropped."""
        self._closed_until_ns = until_ns
        return self.disconnect()

    def closed(self, now_ns: int) -> bool:
        """Return whether it was closed and is to stay so."""
        return now_ns < self._closed_until_ns

    def silent(self, now_ns: int) -> bool:
        """Return whether it is not connected, or has received nothing for its patience."""
        if self.closed(now_ns):
            return False
        return self.address is None or now_ns >= self._silent_ns

    def take_answer(self, answered: Sequence[sockets.Socket]) -> None:
        """Note which sockets' requests to connect a host has answered."""
        self.answered = self.answered or self.socket in answered

    def connect(self, address: str, now_ns: int, fast_retry: bool = True) -> None:
        """Connect to `address` instead of the one before; the two may be the same.

        fast_retry: repeat the request to connect after `answer_ns`, where that may be.
        """
        fast_retry = fast_retry and self._tries % (FAST_RETRIES + 1) < FAST_RETRIES
        self._tries += 1
        self.asked_ns, self.answered = now_ns, False
        sockets.reconnect(self.socket, self.address, address, self.answer_ns if fast_retry else 0)
        self.address = address
        self._silent_ns = now_ns + PATIENCE_NS

    def disconnect(self) -> int:
        """Close the connection; return how many messages were dropped that had queued on it."""
        if self.address is not None:
            sockets.disconnect(self.socket, self.address)
        self.address, self.answered, self._received = None, False, 0
        return self.drop()

    def drop(self) -> int:
        """Drop what has queued, and let ZeroMQ end what was closed; return how many messages."""
        return sum(1 for _ in sockets.receive_each(self.socket))
