"""The front desk: answers what displays ask on the control socket, and knows who listens."""

from collections import Counter
from dataclasses import dataclass

from protocol.errors import WireError
from protocol.messages import (
    ClockReply,
    ClockRequest,
    Control,
    Hello,
    Report,
    Welcome,
    decode_control,
)
from protocol.stream import StreamDescription

FORGET_AFTER_NS = 5_000_000_000
MAX_GUESTS = 1_000

Sender = tuple[bytes, ...]
"""The envelope a control message came in; a reply goes back in the same."""


@dataclass(slots=True)
class Guest:
    """A display that has spoken to us: its name, when it last did, and its last report."""

    name: str
    seen_ns: int
    report: Report | None = None


class Desk:
    """Answers control messages of one session. Pure: time comes in."""

    def __init__(self, description: StreamDescription, session: int) -> None:
        self._description = description
        self._session = session
        self.guests: dict[Sender, Guest] = {}
        self.rejected: Counter[str] = Counter()

    def answer(self, sender: Sender, data: bytes, now_ns: int, samples_sent: int) -> Control | None:
        """The reply to a message of `sender`, if one is due; what is invalid is counted."""
        try:
            message = decode_control(data)
        except WireError as error:
            self.rejected[error.cause] += 1
            return None
        guest = self.guests.get(sender)
        if guest is not None:
            guest.seen_ns = now_ns
        match message:
            case Hello(display=name):
                if guest is None and len(self.guests) >= MAX_GUESTS:
                    self.rejected["too_many_displays"] += 1
                    return None
                self.guests[sender] = guest or Guest(name, now_ns)
                return Welcome(self._session, samples_sent, self._description)
            case ClockRequest(t1_ns=t1_ns):
                return ClockReply(self._session, t1_ns, now_ns, now_ns)
            case Report() if message.session != self._session:
                self.rejected["session"] += 1
            case Report() if guest is not None:
                guest.report = message
            case _:
                self.rejected["unexpected"] += 1
        return None

    def forget_silent(self, now_ns: int) -> list[Guest]:
        """Drop displays not heard of for `FORGET_AFTER_NS`; returns them."""
        silent = [k for k, g in self.guests.items() if now_ns - g.seen_ns > FORGET_AFTER_NS]
        return [self.guests.pop(sender) for sender in silent]
