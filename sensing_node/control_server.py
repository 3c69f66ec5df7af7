"""Answers to control messages, a bound on their number, and the displays that send them."""

from collections import Counter
from dataclasses import dataclass, field

from protocol.errors import VersionError, WireError
from protocol.security.budgets import TokenBucket
from protocol.wire.description import StreamDescription
from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    ControlMessage,
    DisplayReport,
    Hello,
    SetPoint,
    Welcome,
    decode_control,
)
from sensing_node.press.set_points import SetPointServer

# A display sends some 52 messages a second in its first minute, 22 later.
DISPLAY_REQUESTS_PER_S = 100.0
LEAST_PER_S, MOST_PER_S = 1_000.0, 10_000.0
REQUESTS_AT_ONCE = 4_000.0
HELD_NS = 5_000_000
FORGET_AFTER_NS = 5_000_000_000
MAX_CLIENTS = 1_000
# A display that has connected again speaks no more on its old connection, but for what is late.
TWINS_AFTER_NS = 1_000_000_000
# A display sends at most 50 clock requests a second, and after a cut all waiting ones at once.
DISPLAY_ANSWERS_PER_S, ANSWERS_AT_ONCE = 200.0, 2_000.0
# Hellos of other versions that are answered, of all peers together.
STRANGERS_PER_S = 10.0

MAX_HOPS = 4
# ROUTER sockets name their peers by a zero and four bytes, and no message begins with a zero. So
# two messages that an attacker on the way has joined (docs/keys.md) are not taken for an envelope.
ADDRESS_BYTES = 5

Sender = tuple[bytes, ...]
"""Envelope of a control message; the reply has the same envelope."""


class RequestBudget:
    """Bound on the control messages that a sensing node reads from all displays. Pure.

    Once the budget is used up, the node reads no control message for 5 ms. Meanwhile a flooding
    peer is blocked by its own full connection. ZeroMQ then reads one message of each connection in
    turn, so that the other displays are answered. held: number of such pauses.
    """

    def __init__(self) -> None:
        self._budget = TokenBucket(LEAST_PER_S, REQUESTS_AT_ONCE)
        self._held_until_ns = 0
        self.held = 0

    def expect(self, displays: int) -> None:
        """Permit the requests of this number of displays."""
        self._budget.rate_per_s = min(MOST_PER_S, LEAST_PER_S + displays * DISPLAY_REQUESTS_PER_S)

    def spend(self, now_ns: int) -> bool:
        """Count a message that was read; return whether the next one may be read as well."""
        if self._budget.take(now_ns):
            return True
        self._held_until_ns = now_ns + HELD_NS
        self.held += 1
        return False

    def held_for_ns(self, now_ns: int) -> int:
        """Return the time until messages may be read; 0 if they may be read now."""
        left_ns = self._held_until_ns - now_ns
        # More than HELD_NS means that the clock has stepped back.
        return left_ns if 0 < left_ns <= HELD_NS else 0


@dataclass(slots=True)
class Client:
    """A display that has sent a message.

    name: empty before it names itself. seen_ns: time of its last message. confirmed: it has
    confirmed the whole stream, or has left before its end.
    """

    name: str
    seen_ns: int
    report: DisplayReport | None = None
    confirmed: bool = False
    #: The node has logged that it joined, by its name.
    is_announced: bool = False
    #: Another display has the same name.
    is_twin: bool = False
    #: First message after another connection had come with the same name.
    again_ns: int | None = None
    budget: TokenBucket = field(
        default_factory=lambda: TokenBucket(DISPLAY_ANSWERS_PER_S, ANSWERS_AT_ONCE), repr=False
    )

    @property
    def shown_name(self) -> str:
        """The name in ASCII, since the peer chose it and it is printed."""
        return ascii(self.name)[1:-1] or "a display"


class ControlServer:
    """Server of one session's control messages, with its clients by envelope. Pure.

    set_points: server of set-points; without one, they are refused. other_version: description of
    the first refused peer of another version, or "".
    """

    def __init__(
        self,
        description: StreamDescription,
        session: int,
        set_points: SetPointServer | None = None,
    ) -> None:
        self._description = description
        self.set_points = set_points
        self._session = session
        self.clients: dict[Sender, Client] = {}
        # Further connections of displays, which began with a set-point, and the old ones of those
        # that have connected again.
        self._further: dict[Sender, Client] = {}
        # Names of displays that were silent. After a cut, an old connection still delivers messages
        # without a name.
        self._forgotten: dict[Sender, str] = {}
        self.rejected: Counter[str] = Counter()
        self.other_version = ""
        self._strangers = TokenBucket(STRANGERS_PER_S, STRANGERS_PER_S)

    @property
    def _size(self) -> int:
        return len(self.clients) + len(self._further)

    @property
    def unconfirmed(self) -> dict[Sender, Client]:
        """The displays that have not confirmed the whole stream."""
        return {sender: each for sender, each in self.clients.items() if not each.confirmed}

    def answer(
        self, sender: Sender, data: bytes, now_ns: int, samples_sent: int
    ) -> ControlMessage | None:
        """Return the reply to a message of `sender`, if one is due; count an invalid one."""
        try:
            if not 1 <= len(sender) <= MAX_HOPS:
                raise WireError("malformed", f"an envelope holds 1 to {MAX_HOPS} addresses")
            if any(len(part) != ADDRESS_BYTES or part[0] for part in sender[1:]):
                raise WireError("malformed", "a part of an envelope is no address")
            message = decode_control(data)
            client = self._client(sender, message, now_ns)
            if not client.budget.take(now_ns):
                raise WireError("flood", "a display sends far more than displays do")
        except VersionError as error:
            self.rejected[error.cause] += 1
            self.other_version = self.other_version or str(error)
            # The peer refuses any answer of this version, and so reports the two versions.
            if error.is_hello and self._strangers.take(now_ns):
                return Welcome(self._session, samples_sent, self._description)
            return None
        except WireError as error:
            self.rejected[error.cause] += 1
            return None
        match message:
            case Hello():
                return Welcome(self._session, samples_sent, self._description)
            case ClockRequest(t1_ns=t1_ns):
                return ClockReply(self._session, t1_ns, now_ns, now_ns)
            case DisplayReport() | Bye() | SetPoint() if message.session != self._session:
                self.rejected["session"] += 1
            case SetPoint() if self.set_points is None:
                self.rejected["no_probe"] += 1
            case SetPoint() if self.set_points is not None:
                return self.set_points.answer(message, now_ns)
            case Bye():
                client.confirmed = True
            case DisplayReport():
                client.report = message
        return None

    def forget_silent(self, now_ns: int) -> list[Client]:
        """Remove the displays that have left or sent nothing for 5 s, and return them.

        Call it while the stream lasts.
        """
        displays, further = (
            [k for k, c in table.items() if c.confirmed or now_ns - c.seen_ns > FORGET_AFTER_NS]
            for table in (self.clients, self._further)
        )
        for sender in further:
            del self._further[sender]
        gone = {sender: self.clients.pop(sender) for sender in displays}
        self._forgotten |= {k: each.name for k, each in gone.items() if not each.confirmed}
        for sender in list(self._forgotten)[:-MAX_CLIENTS]:
            del self._forgotten[sender]
        return list(gone.values())

    def _client(self, sender: Sender, message: ControlMessage, now_ns: int) -> Client:
        """Return the display that sent a message. Raises WireError.

        A display that was forgotten, or has reconnected, continues without a new hello, and must
        still receive the end of the stream.
        """
        match message:
            case Hello(display=name) | DisplayReport(display=name):
                pass
            case ClockRequest() | Bye() | SetPoint():
                name = ""
            case _:
                raise WireError("unexpected", "a message that only sensing nodes send")
        client = self.clients.get(sender)
        if client is None and not name and (forgotten := self._forgotten.pop(sender, "")):
            if any(other.name == forgotten for other in self.clients.values()):
                # The display has connected again, and this is its old connection.
                self._check_room()
                self._further[sender] = Client(forgotten, now_ns)
            else:
                name = forgotten
        replaced = None if client is not None else self._further.get(sender)
        if replaced is not None and replaced.name and name in ("", replaced.name):
            return self._replaced_connection(sender, replaced, name, now_ns)
        further = client is None and not name and not isinstance(message, Bye)
        if further and (sender in self._further or isinstance(message, SetPoint)):
            return self._further_connection(sender, now_ns)
        has_twin = is_announced = False
        # Most messages are clock requests without a name, for which nothing is searched.
        if name and (client is None or client.name != name):
            has_twin, is_announced = self._replace_namesakes(name, now_ns)
        if client is None:
            self._further.pop(sender, None)
            self._check_room()
            client = self.clients[sender] = Client(name, now_ns, is_twin=has_twin)
        client.is_announced |= is_announced
        client.name = name or client.name
        client.seen_ns = now_ns
        return client

    def _replace_namesakes(self, name: str, now_ns: int) -> tuple[bool, bool]:
        """Take the displays of a name for old connections of the one that sends it now.

        The display may have an entry under an old address, or from a request before its name.
        Return whether there is another display of that name, and whether it was announced.
        """
        has_twin = is_announced = False
        for sender in [k for k, other in self.clients.items() if other.name == name]:
            replaced = self.clients[sender]
            if replaced.is_twin and now_ns - replaced.seen_ns < TWINS_AFTER_NS:
                has_twin = True
                continue
            is_announced |= self._make_further(sender)
            if self._size >= MAX_CLIENTS:
                # The display that replaces it needs the room.
                del self._further[sender]
        return has_twin, is_announced

    def _make_further(self, sender: Sender) -> bool:
        """Take a display for the old connection of another; return whether it was announced."""
        client = self._further[sender] = self.clients.pop(sender)
        client.is_twin, client.again_ns = False, None
        return client.is_announced

    def _replaced_connection(
        self, sender: Sender, client: Client, name: str, now_ns: int
    ) -> Client:
        """Return the display of an old connection, which is a client again if it goes on."""
        client.seen_ns = now_ns
        if client.again_ns is None:
            client.again_ns = now_ns
        elif name and now_ns - client.again_ns >= TWINS_AFTER_NS:
            others = {k: other for k, other in self.clients.items() if other.name == name}
            silent = {k for k, other in others.items() if self._has_left(other, client, now_ns)}
            twins = [other for k, other in others.items() if k not in silent]
            if any(other.seen_ns - client.again_ns < TWINS_AFTER_NS for other in twins):
                # What it has sent since may be late: the next report decides.
                return client
            announced = {self._make_further(k) for k in silent}
            client.is_announced = True in announced
            client.is_twin = bool(twins)
            for other in twins:
                other.is_twin = True
            self.clients[sender] = self._further.pop(sender)
        return client

    @staticmethod
    def _has_left(other: Client, client: Client, now_ns: int) -> bool:
        """Return whether the display of both has left the other connection for the client's."""
        again_ns = now_ns if client.again_ns is None else client.again_ns
        return other.seen_ns < again_ns or now_ns - other.seen_ns >= TWINS_AFTER_NS

    def _further_connection(self, sender: Sender, now_ns: int) -> Client:
        """Return the further connection of a display, which is no display of its own."""
        client = self._further.get(sender)
        if client is None:
            self._check_room()
            client = self._further[sender] = Client("", now_ns)
        client.seen_ns = now_ns
        return client

    def _check_room(self) -> None:
        """Raise WireError where there are as many displays and further connections as may be."""
        if self._size >= MAX_CLIENTS:
            raise WireError("too_many_displays", f"there are {MAX_CLIENTS} already")
