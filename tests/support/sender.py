"""A sensing side for tests: makes the bytes a display receives, in virtual time."""

from dataclasses import dataclass, field

import numpy as np

from display_node.display import Display
from protocol.wire.messages import (
    ClockReply,
    ClockRequest,
    Control,
    Frame,
    Hello,
    Welcome,
    encode_control,
    encode_frame,
)
from protocol.wire.stream import StreamDescription
from tests.support.streams import description

MS = 1_000_000
AHEAD_NS = 5_000_000_000


@dataclass
class Sender:
    """Answers a display's requests at once and sends it frames; its clock is 5 s ahead."""

    session: int = 7
    stream: StreamDescription = field(default_factory=description)
    sent: int = 0

    def answer(self, request: Control, now_ns: int) -> bytes | None:
        match request:
            case Hello():
                return encode_control(Welcome(self.session, self.sent, self.stream))
            case ClockRequest(t1_ns=t1_ns):
                t_ns = now_ns + AHEAD_NS
                return encode_control(ClockReply(self.session, t1_ns, t_ns, t_ns))
            case _:
                return None

    def frame(self, now_ns: int, force_n: float, count: int = 5) -> bytes:
        """A frame whose last sample is taken at now_ns of the display's clock."""
        return self.frame_of(now_ns, [force_n] * count)

    def frame_of(self, now_ns: int, forces_n: list[float]) -> bytes:
        """A frame of these samples, on every channel; the last is taken at now_ns."""
        stream, count = self.stream, len(forces_n)
        t_first_ns = now_ns + AHEAD_NS - (count - 1) * stream.period_ns
        column = np.array(forces_n, f"<f{stream.bytes_per_sample}")[:, np.newaxis]
        values = np.repeat(column, len(stream.channels), axis=1)
        frame = Frame(self.session, self.sent, t_first_ns, stream.period_ns, values)
        self.sent += count
        return encode_frame(frame)


def run(
    display: Display, sender: Sender | None, from_ms: int, to_ms: int, force_n: float = 0.3
) -> list[float]:
    """Tick from one time to the other, 5 samples every 5 ms arriving; felt force by tick.

    Without a sender the link is cut.
    """
    felt = []
    for ms in range(from_ms, to_ms):
        now_ns = ms * MS
        felt.append(display.tick(now_ns).felt_n)
        for request in display.requests(now_ns):
            answer = sender.answer(request, now_ns) if sender else None
            if answer is not None:
                display.on_control(answer, now_ns)
        if sender and ms % 5 == 0:
            display.on_frame(sender.frame(now_ns, force_n), now_ns)
    return felt
