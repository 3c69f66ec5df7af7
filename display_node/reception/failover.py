"""Opening of a second connection beside a silent one, and the choice of the one to keep.

After a cut, TCP repeats what was lost only after as long again as the cut has lasted. A new
connection is there within a few round trips, but on a link that only loses much, the old one may
recover first, and it has what was sent meanwhile. So a second connection is opened beside the
silent one (as RFC 8305 does with addresses), both are read, and one is closed as soon as the other
has all that it could still bring. Pure: time comes in, sockets are the caller's.
"""

from enum import Enum

from protocol.security.token_bucket import TokenBucket

# TCP repeats what was lost 0.2 s and a round trip later, and if that is lost as well, after twice
# as long, and so on. A silence for longer than the first of these is a cut: a new connection is
# there sooner.
REPEATED_NS = 200_000_000
# Where this process itself stood still, it first receives what has queued meanwhile, within the
# first of these; the connection is dead if no more follows that within the second.
COMES_IN_WITHIN_NS = 50_000_000
FOLLOWS_WITHIN_NS = 150_000_000
PATIENCE_FRAMES = 3
# A request to connect that no host has answered is made anew after so long. ZeroMQ repeats it
# sooner, but always to the same address.
UNANSWERED_NS = 2_000_000_000
# A connection that a host has answered delivers within some six round trips, unless one of them was
# lost; twice as long is allowed each time.
STALLED_NS = 250_000_000
STALLED_ANSWERS = 2
# Where TCP goes on after a silence, what has queued comes by one packet, then two, then four, a
# round trip apart. If most of it is not here after so long, a new connection is sooner up to date.
CAUGHT_UP_NS = 100_000_000
MOST = 0.8
LEAST_OWED = 8
# The sensing node queues a second of frames for a display: what a connection has not delivered by
# then comes too late.
SETTLED_NS = 1_000_000_000
# Links that lose much, and peers that stall, are silent again and again.
OPENED_PER_S, OPENED_AT_ONCE = 0.5, 10


class Keep(Enum):
    """The one of two connections that is kept; the other is to be closed."""

    FIRST = "first"
    SECOND = "second"


class Failover:
    """The judge of one data path's two connections.

    racing: a second connection is open. opened: how often one was opened, or opened anew; kept: how
    often it was kept in place of the first.
    """

    def __init__(self) -> None:
        self._silence_ns, self._follows_ns = 2 * REPEATED_NS, FOLLOWS_WITHIN_NS
        self._stalled_ns = self._stalls_after_ns = STALLED_NS
        self._budget = TokenBucket(OPENED_PER_S, OPENED_AT_ONCE)
        self._frame_ns = REPEATED_NS
        # After a silence: messages that are still missing, and by when they should have come.
        self._owed, self._caught_up_ns = 0.0, 0
        self._due_ns = self._suspect_until_ns = self._first_ns = 0
        # In a race: since when the first has been delivering again, and the second.
        self._back_ns: int | None = None
        self._second_ns: int | None = None
        self._answered = self._known = False
        self.racing = False
        self.opened = self.kept = 0

    def set_timeouts(self, frame_ns: int, answer_ns: int) -> None:
        """Expect a frame every `frame_ns`, and the answer to a request to connect within
        `answer_ns`."""
        self._frame_ns = frame_ns
        least_ns = PATIENCE_FRAMES * frame_ns
        was_ns, self._silence_ns = self._silence_ns, max(REPEATED_NS + answer_ns, least_ns)
        if not self.racing:
            self._due_ns += self._silence_ns - was_ns
        self._follows_ns = max(FOLLOWS_WITHIN_NS, least_ns)
        self._stalls_after_ns = max(STALLED_NS, STALLED_ANSWERS * answer_ns) + frame_ns

    def start(self, now_ns: int) -> None:
        """Begin to expect frames: they have been asked for."""
        self._known = False
        self._first_ns, self._due_ns = now_ns, now_ns + self._silence_ns

    def first_heard(self, now_ns: int, had: bool, count: int) -> Keep | None:
        """Note that the first connection has delivered; return which to keep, if that is clear.

        had: among the `count` messages was what the second had delivered before. Then the second
        has all the rest.
        """
        if not self.racing:
            self._expect_next(now_ns, count)
            return None
        if had:
            return self._keep(Keep.SECOND, now_ns)
        if self._back_ns is None or now_ns - self._first_ns >= self._silence_ns:
            self._back_ns = now_ns
        self._first_ns = now_ns
        self._due_ns = max(self._due_ns, now_ns + self._silence_ns)
        return None

    def _expect_next(self, now_ns: int, count: int) -> None:
        suspect = now_ns < self._suspect_until_ns
        self._due_ns = now_ns + (self._follows_ns if suspect else self._silence_ns)
        silence_ns, self._first_ns = now_ns - self._first_ns, now_ns
        owed = MOST * silence_ns / self._frame_ns
        # Before it was asked for, nothing was owed.
        known, self._known = self._known, True
        if known and silence_ns >= self._silence_ns // 2 and owed >= LEAST_OWED:
            self._owed, self._caught_up_ns = owed, now_ns + CAUGHT_UP_NS
        self._owed -= count
        if self._owed > 0:
            self._due_ns = min(self._due_ns, self._caught_up_ns)

    def second_heard(self, now_ns: int, had: bool) -> Keep | None:
        """Note that the second connection has delivered; return which to keep, if that is clear.

        had: among it was what the first had delivered before. Then the first is up to date.
        """
        if not self.racing:
            return None
        if had:
            return self._keep(Keep.FIRST, now_ns)
        if self._second_ns is None:
            self._second_ns = now_ns
        self._due_ns = now_ns + self._silence_ns
        return None

    def settle(self, now_ns: int) -> Keep | None:
        """Return which connection to keep where the other has had time enough."""
        if not self.racing:
            return None
        if self._second_ns is not None:
            since_ns = max(self._second_ns, self._first_ns)
            over = now_ns - since_ns >= SETTLED_NS or now_ns - self._second_ns >= 2 * SETTLED_NS
            return self._keep(Keep.SECOND, now_ns) if over else None
        back = self._back_ns is not None and now_ns - self._back_ns >= SETTLED_NS
        if back and now_ns - self._first_ns < self._silence_ns:
            return self._keep(Keep.FIRST, now_ns)
        return None

    def mark_suspect(self, now_ns: int) -> None:
        """Expect frames sooner, as this process stood still: the first connection may have died
        meanwhile, and what it delivers may only have queued."""
        if not self.racing:
            self._suspect_until_ns = now_ns + COMES_IN_WITHIN_NS
            self._due_ns = min(self._due_ns, now_ns + self._follows_ns)

    def give_up(self) -> None:
        """Wait no longer for the first connection."""
        if not self.racing:
            self._due_ns = 0

    def abandon(self) -> None:
        """End a race without an outcome: both connections are closed."""
        self.racing = self._answered = False
        self._back_ns = self._second_ns = None
        self._owed = 0.0

    def due(self, now_ns: int) -> bool:
        """Return whether the second connection is to be opened now, or opened anew."""
        if now_ns < self._due_ns or not self._budget.take(now_ns):
            return False
        if not self.racing:
            self._stalled_ns = self._stalls_after_ns
        elif self._answered:
            self._stalled_ns = min(2 * self._stalled_ns, UNANSWERED_NS)
        self.racing, self._answered, self._second_ns = True, False, None
        self._due_ns = now_ns + UNANSWERED_NS
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
        self._first_ns, self._due_ns = now_ns, now_ns + self._silence_ns
        return which
