"""A receiver that is fed with the messages that a display captured, from telemetry or a recording.

It is the display's own `Receiver`, so clock, delays and sample counts come out as in the display.
Pure.
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


class PassiveReceiver(Receiver):
    """Receiver that sends nothing: the display sent the clock requests."""

    def __init__(self) -> None:
        super().__init__("listener", 0, LATE_TARGET, PATHS)
        # Each reply is accepted once, as in the display.
        self._requests_ns: deque[int] = deque(maxlen=MAX_ASKED)

    def take(self, topic: str, fields: dict[str, Any]) -> Frame | None:
        """Process a message of a recording.

        Returns
        -------
        Frame or None
            The frame in it, if the display accepted it.

        Raises
        ------
        KeyError, ValueError, TypeError
            The fields are not those of a telepulse recording.
        """
        if topic == FRAME or (topic == REFUSED and fields["path"] != CONTROL):
            return self.on_frame(b64decode(fields["data"]), fields["arrived_ns"])
        if topic in (STREAM, REFUSED):
            self.on_control(b64decode(fields["data"]), fields["arrived_ns"])
        elif topic == CLOCK:
            reply = ClockReply(*(fields[name] for name in ("session", "t1_ns", "t2_ns", "t3_ns")))
            if reply.t1_ns not in self._requests_ns:
                self._requests_ns.append(reply.t1_ns)
                self._asked_ns.append(reply.t1_ns)
            self.on_control(encode_control(reply), fields["t4_ns"])
        return None

    def play(self, instant_ns: int) -> None:
        """Advance the buffer to an instant of the pulse that a tick played."""
        if self.ready:
            late_ns = 0 if self.description is None else self.description.group_delay_ns
            self.buffer.advance(instant_ns + late_ns)
