"""A display's receiver once more, told what a recording, or telemetry, says that it heard.

So clock, delays and accounts come out as they did in the display. Pure.
"""

from base64 import b64decode
from collections import deque
from typing import Any

from display_node.reception.delay_estimator import LATE_TARGET
from display_node.reception.receiver import MAX_ASKED, Receiver
from protocol.wire.messages import ClockReply, Frame, encode_control
from protocol.wire.telemetry import CONTROL
from telepulse.telemetry.schema import CLOCK, FRAME, REFUSED, STREAM

# More than one: a frame that came twice is a copy then, never refused.
PATHS = 2


class CapturedReceiver(Receiver):
    """A receiver whose clock requests were sent by another."""

    def __init__(self) -> None:
        super().__init__("listener", 0, LATE_TARGET, PATHS)
        self._told_ns: deque[int] = deque(maxlen=MAX_ASKED)

    def asked(self, t1_ns: int) -> None:
        """A request was sent at t1; its reply is taken once."""
        if t1_ns not in self._told_ns:
            self._told_ns.append(t1_ns)
            self._asked_ns.append(t1_ns)


class Listener:
    """Follows what a display heard; receiver: what it made of it."""

    def __init__(self) -> None:
        self.receiver = CapturedReceiver()

    def take(self, topic: str, fields: dict[str, Any]) -> Frame | None:
        """A message of a recording; the frame in it, if it is one that the display took.

        Raises KeyError, ValueError or TypeError where the fields are not telepulse's.
        """
        receiver = self.receiver
        if topic == FRAME or (topic == REFUSED and fields["path"] != CONTROL):
            return receiver.on_frame(b64decode(fields["data"]), fields["arrived_ns"])
        if topic in (STREAM, REFUSED):
            receiver.on_control(b64decode(fields["data"]), fields["arrived_ns"])
        elif topic == CLOCK:
            reply = ClockReply(*(fields[name] for name in ("session", "t1_ns", "t2_ns", "t3_ns")))
            receiver.asked(reply.t1_ns)
            receiver.on_control(encode_control(reply), fields["t4_ns"])
        return None

    def play(self, instant_ns: int) -> None:
        """A tick played this instant of the pulse."""
        if self.receiver.ready:
            description = self.receiver.description
            late_ns = description.group_delay_ns if description is not None else 0
            self.receiver.buffer.advance(instant_ns + late_ns)
