"""A data path: the connection that frames come over, and a second one while that is silent."""

from collections.abc import Iterator

import zmq

from display_node.reception.endpoint import Endpoint
from display_node.reception.failover import Failover, Keep
from protocol import sockets
from protocol.security.keys import ClientKeys

# Of a race: some seconds of frames. They are told by their hashes.
MAX_REMEMBERED = 20_000


class DataPath:
    """Two data sockets of which one is used, and the other as well where the first is silent.

    first: the one that is used. failover: when the second is, and which of the two is kept.
    """

    def __init__(self, context: sockets.Context, keys: ClientKeys | None) -> None:
        self.lines = [Endpoint(sockets.unconnected(context, zmq.SUB, keys)) for _ in range(2)]
        self.first, self._second = self.lines
        self.failover = Failover()
        self._subscribed = False
        self._found: str | None = None
        self._forget()

    def messages(self) -> Iterator[bytes]:
        """Yield the messages that wait; of those that both connections bring, one copy."""
        if not self.failover.racing:
            yield from self.first.messages()
            return
        for line, own, other in (
            (self.first, self._of_first, self._of_second),
            (self._second, self._of_second, self._of_first),
        ):
            for message in line.messages():
                number = hash(message)
                if number in other:
                    self._had.add(line)
                    continue
                if number in self._before:
                    continue
                if len(own) < MAX_REMEMBERED:
                    own.add(number)
                yield message

    def subscribe(self, now_ns: int) -> None:
        """Ask for all that is published."""
        self._subscribed = True
        self.failover.start(now_ns)
        for line in self.lines:
            line.socket.subscribe(b"")

    def unsubscribe(self) -> None:
        """Ask for nothing any more, and expect nothing; the first connection stays."""
        self._subscribed = False
        self.failover.abandon()
        self._second.disconnect()
        self._forget()
        for line in self.lines:
            line.socket.unsubscribe(b"")

    def take_heard(self, now_ns: int) -> bool:
        """Return whether anything has come since this was called last; close a connection that is
        not needed any more."""
        first, second, failover = self.first, self._second, self.failover
        from_first, from_second = first.heard(now_ns), second.heard(now_ns)
        keep = None
        if from_first:
            keep = failover.first_heard(now_ns, first in self._had, from_first)
        if from_second and keep is None:
            keep = failover.second_heard(now_ns, second in self._had)
        keep = keep or failover.settle(now_ns)
        if keep is Keep.SECOND:
            self.first, self._second = second, first
        if keep is not None:
            self._second.disconnect()
            self._forget()
        return from_first + from_second > 0

    def tend(self, now_ns: int, found: str | None) -> bool:
        """Connect what is to be connected; call each tick, after `take_heard`.

        found: the address with a number for a name, where it has just been looked up. Returns
        whether to look it up.
        """
        self._found = found or self._found
        first, second, failover = self.first, self._second, self.failover
        if first.closed(now_ns):
            first.drop()
            return False
        if not self._subscribed or first.address is None:
            if found is not None:
                first.connect(found, now_ns, hurried=False)
                failover.start(now_ns)
            return first.silent(now_ns)
        if not failover.racing:
            second.drop()
        elif second.answered:
            failover.answered(now_ns)
        if not failover.due(now_ns):
            return False
        # First where the connection was good; then where the name has led to since.
        address = self._found if second.address is not None else first.address
        # What the last attempt brought is known, but the next has not had it.
        if len(self._before) > MAX_REMEMBERED:
            self._before.clear()
        self._before |= self._of_second
        self._of_second.clear()
        second.connect(address or first.address, now_ns)
        return True

    def flooded(self, now_ns: int) -> bool:
        """Return whether either connection has brought more than is allowed; call it each tick."""
        first, second = self.lines
        return first.flooded(now_ns) | second.flooded(now_ns)

    def close(self, until_ns: int) -> int:
        """Close both connections until then; return how many messages were dropped."""
        self.failover.abandon()
        self._forget()
        return sum(line.close(until_ns) for line in self.lines)

    def _forget(self) -> None:
        """Begin a race with nothing known of either connection's messages."""
        self._of_first: set[int] = set()
        self._of_second: set[int] = set()
        self._before: set[int] = set()
        self._had: set[Endpoint] = set()
