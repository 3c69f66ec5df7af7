"""Opening of a second connection beside a silent one, and the choice of the one to keep.

After a cut, TCP may repeat lost data only after a wait as long as the cut; a new connection takes a
few round trips. On a link that is merely lossy, the old connection may recover first, and it
delivers what was sent meanwhile. So a second connection is opened beside the silent one (as RFC
8305 does with addresses), and both are read. A connection is closed once the other has delivered
everything that it could still deliver. `Failover` decides and is pure; `DataPath` has the sockets.
"""

from collections.abc import Iterable, Iterator
from enum import Enum

import zmq

from display_node.reception.endpoint import Endpoint
from display_node.reception.timeouts import Timeouts
from protocol import sockets
from protocol.security.budgets import TokenBucket
from protocol.security.link_keys import ClientKeys

# After a stall of this process, queued messages arrive within this time.
COMES_IN_WITHIN_NS = 50_000_000
# When TCP resumes after a silence, queued data comes as one packet, then two, then four, a round
# trip apart. If less than the share MOST of it has come within this time, a new
# connection is faster.
CAUGHT_UP_NS = 100_000_000
MOST = 0.8
LEAST_OWED = 8
# The sensing node queues one second of frames for a display; anything older comes too late.
SETTLED_NS = 1_000_000_000
# Bound on new connections: lossy links, and peers that stall, are silent repeatedly.
OPENED_PER_S, OPENED_AT_ONCE = 0.5, 10


class Keep(Enum):
    """Connection that is kept; the other one is to be closed."""

    FIRST = "first"
    SECOND = "second"


class Failover:
    """Decisions about one data path's two connections.

    A single time decides, `_due_ns`: at it, the second connection is opened, or opened anew. Each
    event moves it by one of the `Timeouts`, and the last event's counts.

    timeouts: times of silence. racing: whether a second connection is open. opened, kept: number of
    second connections so far, and of those that replaced the first one.
    """

    def __init__(self) -> None:
        self.timeouts = Timeouts()
        # Of the present race: grows with each attempt that stalls.
        self._stalled_ns = self.timeouts.stalled_ns
        self._budget = TokenBucket(OPENED_PER_S, OPENED_AT_ONCE)
        # After a silence: number of messages still missing, and the time by which they are due.
        self._owed, self._caught_up_ns = 0.0, 0
        self._due_ns = self._suspect_until_ns = self._first_ns = 0
        # In a race: time since which the first delivers again, and since which the second does.
        self._back_ns: int | None = None
        self._second_ns: int | None = None
        self._answered = self._known = False
        self.racing = False
        self.opened = self.kept = 0

    def set_timeouts(self, timeouts: Timeouts) -> None:
        """Apply other times of silence, also to the present silence."""
        was, self.timeouts = self.timeouts, timeouts
        if not self.racing:
            self._due_ns += timeouts.silence_ns - was.silence_ns

    def start(self, now_ns: int) -> None:
        """Begin to expect frames, which have been subscribed to."""
        self._known = False
        self._first_ns, self._due_ns = now_ns, now_ns + self.timeouts.silence_ns

    def first_received(self, now_ns: int, behind: bool, count: int) -> Keep | None:
        """Take `count` messages of the first connection; return which to keep, if that is clear.

        behind: one of the messages had come over the second connection already. The second is then
        ahead, and the first is not needed.
        """
        if not self.racing:
            self._expect_next(now_ns, count)
        elif behind:
            return self._keep(Keep.SECOND, now_ns)
        else:
            if self._back_ns is None or now_ns - self._first_ns >= self.timeouts.silence_ns:
                self._back_ns = now_ns
            self._first_ns = now_ns
            self._due_ns = max(self._due_ns, now_ns + self.timeouts.silence_ns)
        return None

    def _expect_next(self, now_ns: int, count: int) -> None:
        suspect = now_ns < self._suspect_until_ns
        timeouts = self.timeouts
        self._due_ns = now_ns + (timeouts.follows_ns if suspect else timeouts.silence_ns)
        silence_ns, self._first_ns = now_ns - self._first_ns, now_ns
        owed = MOST * silence_ns / timeouts.frame_ns
        # Nothing was owed before the subscription.
        known, self._known = self._known, True
        if known and silence_ns >= timeouts.silence_ns // 2 and owed >= LEAST_OWED:
            self._owed, self._caught_up_ns = owed, now_ns + CAUGHT_UP_NS
        self._owed -= count
        if self._owed > 0:
            self._due_ns = min(self._due_ns, self._caught_up_ns)

    def second_received(self, now_ns: int, behind: bool) -> Keep | None:
        """Take messages of the second connection; return which to keep, if that is clear.

        behind: one of them had come over the first connection already, so that one is ahead.
        """
        if not self.racing:
            return None
        if behind:
            return self._keep(Keep.FIRST, now_ns)
        if self._second_ns is None:
            self._second_ns = now_ns
        self._due_ns = now_ns + self.timeouts.silence_ns
        return None

    def settle(self, now_ns: int) -> Keep | None:
        """Return which connection to keep once the other has had enough time."""
        if not self.racing:
            return None
        which, first_ns = Keep.FIRST, now_ns - self._first_ns
        if self._second_ns is not None:
            which, second_ns = Keep.SECOND, now_ns - self._second_ns
            over = min(second_ns, first_ns) >= SETTLED_NS or second_ns >= 2 * SETTLED_NS
        else:
            back = self._back_ns is not None and now_ns - self._back_ns >= SETTLED_NS
            over = back and first_ns < self.timeouts.silence_ns
        return self._keep(which, now_ns) if over else None

    def mark_suspect(self, now_ns: int) -> None:
        """Expect frames sooner after a stall of this process.

        The first connection may be dead although it delivers: its frames may have queued.
        """
        if not self.racing:
            self._suspect_until_ns = now_ns + COMES_IN_WITHIN_NS
            self._due_ns = min(self._due_ns, now_ns + self.timeouts.follows_ns)

    def give_up(self) -> None:
        """Let a second connection be due at once."""
        if not self.racing:
            self._due_ns = 0

    def abandon(self) -> None:
        """End a race without an outcome, because both connections are closed."""
        self.racing = self._answered = False
        self._back_ns = self._second_ns = None
        self._owed = 0.0

    def due(self, now_ns: int) -> bool:
        """Return whether the second connection is to be opened now, or opened anew."""
        if now_ns < self._due_ns or not self._budget.take(now_ns):
            return False
        if not self.racing:
            self._stalled_ns = self.timeouts.stalled_ns
        elif self._answered:
            self._stalled_ns = min(2 * self._stalled_ns, self.timeouts.unanswered_ns)
        self.racing, self._answered, self._second_ns = True, False, None
        self._due_ns = now_ns + self.timeouts.unanswered_ns
        self.opened += 1
        return True

    def answered(self, now_ns: int) -> None:
        """Note that a host has answered the second connection's request."""
        if self.racing and not self._answered:
            self._answered = True
            self._due_ns = now_ns + self._stalled_ns

    def _keep(self, which: Keep, now_ns: int) -> Keep:
        self.kept += which is Keep.SECOND
        self.abandon()
        self._first_ns, self._due_ns = now_ns, now_ns + self.timeouts.silence_ns
        return which


# Frames of a race that are remembered by their hashes: those of some seconds.
MAX_REMEMBERED = 20_000


class DataPath:
    """Two data sockets: `first` is used, and the second one too while the first is silent."""

    def __init__(self, context: sockets.Context, keys: ClientKeys | None) -> None:
        self.endpoints = [Endpoint(sockets.unconnected(context, zmq.SUB, keys)) for _ in range(2)]
        self.first, self._second = self.endpoints
        self.failover = Failover()
        self._subscribed = False
        self._found: str | None = None
        self._forget()

    def messages(self) -> Iterator[bytes]:
        """Yield the waiting messages, without the copies that both connections deliver."""
        if not self.failover.racing:
            # The kept connection may still deliver copies of what the other one delivered.
            for message in self.first.messages():
                if not self._before or hash(message) not in self._before:
                    yield message
            return
        for endpoint, own, other in (
            (self.first, self._of_first, self._of_second),
            (self._second, self._of_second, self._of_first),
        ):
            for message in endpoint.messages():
                number = hash(message)
                if number in other:
                    self._behind.add(endpoint)
                elif number not in self._before:
                    if len(own) < MAX_REMEMBERED:
                        own.add(number)
                    yield message

    def subscribe(self, now_ns: int) -> None:
        """Subscribe to everything that is published."""
        self._subscribed = True
        self.failover.start(now_ns)
        for endpoint in self.endpoints:
            endpoint.socket.subscribe(b"")

    def unsubscribe(self) -> None:
        """Cancel the subscription and expect nothing; the first connection stays."""
        self._subscribed = False
        self.failover.abandon()
        self._second.disconnect()
        self._forget()
        for endpoint in self.endpoints:
            endpoint.socket.unsubscribe(b"")

    def set_timeouts(self, timeouts: Timeouts) -> None:
        """Apply other times of silence, and the rate of frames that they are for."""
        self.failover.set_timeouts(timeouts)
        for endpoint in self.endpoints:
            endpoint.answer_ns = timeouts.answer_ns
            endpoint.expect(1e9 / timeouts.frame_ns)

    def take_received(self, now_ns: int) -> int:
        """Return how many frames came since the last call; close an unneeded connection."""
        first, second, failover = self.first, self._second, self.failover
        from_first, from_second = first.received(now_ns), second.received(now_ns)
        keep = None
        if from_first:
            keep = failover.first_received(now_ns, first in self._behind, from_first)
        if from_second and keep is None:
            keep = failover.second_received(now_ns, second in self._behind)
        keep = keep or failover.settle(now_ns)
        if keep is Keep.SECOND:
            self.first, self._second = second, first
        if keep is not None:
            self._second.disconnect()
            self._forget(self._before | self._of_first | self._of_second)
        return from_first + from_second

    def poll(self, now_ns: int, found: str | None) -> bool:
        """Open the connections that are due; call it each tick, after `take_received`.

        found: result of a look-up of the address, once. Returns whether a look-up is needed.
        """
        self._found = found or self._found
        first, second, failover = self.first, self._second, self.failover
        if first.closed(now_ns):
            first.drop()
            return False
        if not self._subscribed or first.address is None:
            if found is not None:
                first.connect(found, now_ns, fast_retry=False)
                failover.start(now_ns)
            return first.silent(now_ns)
        if not failover.racing:
            second.drop()
        elif second.answered:
            failover.answered(now_ns)
        if not failover.due(now_ns):
            return False
        # The first attempt uses the address that worked; later ones use the newest look-up.
        address = self._found if second.address is not None else first.address
        # A frame that the last attempt delivered must not count as a success of the next one.
        if len(self._before) > MAX_REMEMBERED:
            self._before.clear()
        self._before |= self._of_second
        self._of_second.clear()
        second.connect(address or first.address, now_ns)
        return True

    def flooded(self, now_ns: int) -> bool:
        """Return whether either connection has sent more than is permitted; call each tick."""
        first, second = self.endpoints
        return first.flooded(now_ns) | second.flooded(now_ns)

    def close(self, until_ns: int) -> int:
        """Keep both connections closed until a time; return how many messages were dropped."""
        self.failover.abandon()
        self._forget()
        return sum(endpoint.close(until_ns) for endpoint in self.endpoints)

    def _forget(self, before: Iterable[int] = ()) -> None:
        """Forget which connection delivered what; `before` are hashes of messages to drop."""
        self._of_first: set[int] = set()
        self._of_second: set[int] = set()
        self._before = set(before)
        self._behind: set[Endpoint] = set()
