"""A sensing node that sends false but well-formed messages; the receiver's counts must hold."""

import numpy as np

from display_node.reception.jitter_buffer import MAX_AHEAD_SAMPLES
from display_node.reception.receiver import MAX_OPEN_REQUESTS, Receiver
from fuzz.refusals import check_causes
from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    ControlMessage,
    Frame,
    Welcome,
    encode_control,
    encode_frame,
)
from tests.support.streams import description

MS = 1_000_000
AHEAD_NS = 5_000_000_000
BATCH = 8
LATEST_NS = (1 << 62) - 1
DESCRIPTION = description(batch=BATCH)


class StreamPlay:
    """One receiver, played 20 ms behind, in virtual time. Every step checks its counts.

    `off` is the error of a step: in samples, ms or sessions.
    """

    def __init__(self) -> None:
        self.receiver = Receiver("fuzz", [0], late_target=0.01)
        self._now_ns = 0
        self._session = 0
        self._next = 0
        self._asked_ns: list[int] = []
        self._said = 0
        # Samples accepted, and dropped by a new session or a stepped clock.
        self._taken = self._given_up = 0

    def pass_time(self, off: int) -> None:
        """Advance by `off` ms, and play the samples that are due; trust a prediction if even."""
        self._now_ns += abs(off) * MS
        for request in self.receiver.requests(self._now_ns):
            if isinstance(request, ClockRequest):
                self._asked_ns.append(request.t1_ns)
        if self.receiver.accepts_frames:
            sensing_ns = self.receiver.clock.remote_ns(self._now_ns)
            self.receiver.buffer.advance(sensing_ns - 20 * MS, trusted=off % 2 == 0)
        self._check()

    def frame(self, off: int, count: int = BATCH) -> None:
        """Send the next frame, or one that is `off` samples from it."""
        first = max(0, self._next + off)
        if self._frame(first, AHEAD_NS + first * MS, count):
            self._next = max(self._next, first + count)

    def frame_of_another_time(self, off: int) -> None:
        """Send the next frame with a time `off` ms from its own."""
        self._frame(self._next, AHEAD_NS + (self._next + off) * MS, BATCH)

    def welcome(self, off: int) -> None:
        """Send a welcome, of a session `off` from the present one."""
        self._session = max(0, self._session + off)
        if off:
            self._next = 0
        self._hear(Welcome(self._session, self._next, DESCRIPTION))

    def clock_reply(self, off: int) -> None:
        """Reply to the last request, by a clock that is `off` ms wrong."""
        t1_ns = self._asked_ns.pop() if self._asked_ns else self._now_ns
        t_ns = self._now_ns + AHEAD_NS + off * MS
        self._hear(ClockReply(self._session, t1_ns, t_ns, t_ns))

    def bye(self, off: int) -> None:
        """Send the end, `off` samples from the last one sent."""
        self._hear(Bye(self._session, max(0, self._next + off)))

    def _frame(self, first: int, t_first_ns: int, count: int) -> bool:
        """Send a frame; return whether it was accepted."""
        values = np.full((count, 1), 0.3, "<f4")
        frame = Frame(self._session, first, min(t_first_ns, LATEST_NS), MS, values)
        self._said += 1
        taken = self.receiver.on_frame(encode_frame(frame), self._now_ns) is not None
        if taken:
            self._taken += count
        self._check()
        return taken

    def _hear(self, message: ControlMessage) -> None:
        receiver = self.receiver
        waiting, resets = receiver.buffer.waiting, receiver.resets
        self._said += 1
        receiver.on_control(encode_control(message), self._now_ns)
        if receiver.resets != resets:
            self._given_up += waiting
        self._check()

    def _check(self) -> None:
        receiver = self.receiver
        account, waiting = receiver.account(), receiver.buffer.waiting
        arrived = account.played, account.predicted, account.late
        assert min(account.sent, account.lost, *arrived) >= 0
        assert account.sent == sum(arrived) + account.lost
        assert sum(arrived) + waiting + self._given_up == self._taken
        assert 0 <= waiting <= MAX_AHEAD_SAMPLES
        assert receiver.rejected.total() <= self._said
        check_causes(receiver.rejected)
        self._asked_ns = self._asked_ns[-MAX_OPEN_REQUESTS:]
