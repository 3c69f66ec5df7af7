"""The front desk: answers what displays ask on the control socket, and knows who listens.

Bound on the questions of displays that are read: as many as displays send.
"""

from collections import Counter
from dataclasses import dataclass, field

from protocol.errors import WireError
from protocol.security.budgets import TokenBucket
from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    Control,
    DisplayReport,
    Hello,
    Welcome,
    decode_control,
)
from protocol.wire.stream import StreamDescription

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


FORGET_AFTER_NS = 5_000_000_000
MAX_GUESTS = 1_000
# A display asks for the clock 50 times a second, and all at once what waited in a cut.
ANSWERS_PER_S, ANSWERS_AT_ONCE = 200.0, 2_000.0
# Each relay on the way adds an address to the envelope.
MAX_HOPS = 4
# ROUTER sockets name their peers by a zero and four bytes; no message begins with a zero. So one
# that was joined to the next on the way is no envelope.
ADDRESS_BYTES = 5

Sender = tuple[bytes, ...]
"""The envelope a control message came in; a reply goes back in the same."""


@dataclass(slots=True)
class Client:
    """Display that has sent a message.

    It has a name, the time of its last message, its last report, and whether it has confirmed the
    whole stream.
    """

    name: str
    seen_ns: int
    report: DisplayReport | None = None
    content: bool = False
    budget: TokenBucket = field(
        default_factory=lambda: TokenBucket(ANSWERS_PER_S, ANSWERS_AT_ONCE), repr=False
    )

    @property
    def shown_name(self) -> str:
        """The name in letters that every terminal has: a peer chose it."""
        return ascii(self.name)[1:-1] or "a display"


class ControlServer:
    """Answers control messages of one session. Pure: time comes in."""

    def __init__(self, description: StreamDescription, session: int) -> None:
        self._description = description
        self._session = session
        self.guests: dict[Sender, Client] = {}
        self.rejected: Counter[str] = Counter()

    @property
    def all_content(self) -> bool:
        """Whether every display has said that it has the whole stream."""
        return all(guest.content for guest in self.guests.values())

    def answer(self, sender: Sender, data: bytes, now_ns: int, samples_sent: int) -> Control | None:
        """Return the reply to a message of `sender`, if one is due; count an invalid one."""
        try:
            if not 1 <= len(sender) <= MAX_HOPS:
                raise WireError("malformed", f"an envelope holds 1 to {MAX_HOPS} addresses")
            if any(len(part) != ADDRESS_BYTES or part[0] for part in sender[1:]):
                raise WireError("malformed", "a part of an envelope is no address")
            message = decode_control(data)
            guest = self._guest(sender, message, now_ns)
            if not guest.budget.take(now_ns):
                raise WireError("flood", "a display sends far more than displays do")
        except WireError as error:
            self.rejected[error.cause] += 1
            return None
        match message:
            case Hello():
                return Welcome(self._session, samples_sent, self._description)
            case ClockRequest(t1_ns=t1_ns):
                return ClockReply(self._session, t1_ns, now_ns, now_ns)
            case DisplayReport() | Bye() if message.session != self._session:
                self.rejected["session"] += 1
            case Bye():
                guest.content = True
            case DisplayReport():
                guest.report = message
        return None

    def _guest(self, sender: Sender, message: Control, now_ns: int) -> Client:
        """Return the display that sent a message. Raises WireError.

        A display that was forgotten, or whose connection was made anew, goes on without
        another hello and still must be told where the stream ends.
        """
        match message:
            case Hello(display=name) | DisplayReport(display=name):
                pass
            case ClockRequest() | Bye():
                name = ""
            case _:
                raise WireError("unexpected", "a message that only sensing nodes send")
        guest = self.guests.get(sender)
        # Most messages are clock requests, which have no name: they must not cost a look at all.
        if name and (guest is None or guest.name != name):
            self._forget_namesake(name)
        if guest is None:
            if len(self.guests) >= MAX_GUESTS:
                raise WireError("too_many_displays", f"there are {MAX_GUESTS} already")
            guest = self.guests[sender] = Client(name, now_ns)
        guest.name = name or guest.name
        guest.seen_ns = now_ns
        return guest

    def _forget_namesake(self, name: str) -> None:
        """Remove the old address of a display that connects again from another one.

        It may have asked for the clock before it said its name.
        """
        for sender in [k for k, guest in self.guests.items() if guest.name == name]:
            del self.guests[sender]

    def forget_silent(self, now_ns: int) -> list[Client]:
        """Drop displays not heard of for `FORGET_AFTER_NS`; returns them."""
        silent = [k for k, g in self.guests.items() if now_ns - g.seen_ns > FORGET_AFTER_NS]
        return [self.guests.pop(sender) for sender in silent]
