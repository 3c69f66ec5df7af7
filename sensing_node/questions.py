"""Bound on the questions of displays that are read: as many as displays send."""

from protocol.token_bucket import TokenBucket

# A display sends some 52 messages a second in its first minute, 22 later.
QUESTIONS_PER_S = 100.0
LEAST_PER_S, MOST_PER_S = 1_000.0, 10_000.0
QUESTIONS_AT_ONCE = 4_000.0
HELD_NS = 5_000_000


class QuestionBudget:
    """The bound on how many questions a sensing node reads, all displays together.

    Once the budget is used up, the node reads no control message for 5 ms. The messages stay
    where they are: a flooding peer is held up by its own full connection, and ZeroMQ reads one
    message of each connection in turn, so that the other displays are answered. Pure: time
    comes in.

    Attributes
    ----------
    held
        How often reading was held back.
    """

    def __init__(self) -> None:
        self._budget = TokenBucket(LEAST_PER_S, QUESTIONS_AT_ONCE)
        self._held_until_ns = 0
        self.held = 0

    def expect(self, displays: int) -> None:
        """Allow for the questions of so many displays."""
        rate_per_s = LEAST_PER_S + displays * QUESTIONS_PER_S
        self._budget.change_rate(min(MOST_PER_S, rate_per_s))

    def spend(self, now_ns: int) -> bool:
        """Count a message that was read; return whether the next one may be read as well."""
        if self._budget.take(now_ns):
            return True
        self._held_until_ns = now_ns + HELD_NS
        self.held += 1
        return False

    def held_for_ns(self, now_ns: int) -> int:
        """Return for how long nothing may be read from now on, in ns; 0 where it may be."""
        left_ns = self._held_until_ns - now_ns
        # A clock that has stepped back holds nothing.
        return left_ns if 0 < left_ns <= HELD_NS else 0
