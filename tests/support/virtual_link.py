"""A pulse over any link in virtual time: what arrives at a display when, and what it then plays."""

import heapq
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from display_node.display import Display
from protocol.wire.messages import (
    ClockReply,
    ClockRequest,
    Frame,
    Hello,
    Welcome,
    encode_control,
    encode_frame,
)
from protocol.wire.stream import StreamDescription
from tests.support.streams import description

MS = 1_000_000
HOUR_NS = 3_600_000 * MS
AHEAD_NS = 5_000_000_000
BATCH = 5
WAY_NS = 20 * MS

Clock = Callable[[int], int]
"""A host's clock: what it shows at a true time, both in ns."""


def pulse_n(true_ns: float) -> float:
    """The force at the wrist, in N: 1.2 beats a second."""
    return 0.3 + 0.1 * math.sin(2 * math.pi * 1.2 * true_ns * 1e-9)


def ahead_ns(true_ns: int) -> int:
    """A sensing clock that runs true and shows 5 s more."""
    return true_ns + AHEAD_NS


def true_time_ns(true_ns: int) -> int:
    """A display clock that shows the true time."""
    return true_ns


@dataclass
class VirtualLink:
    """A sensing node, a display, and what comes over the link between them.

    delays_ns: of a frame, by its number and the time it is sent: one for each copy that arrives.
    """

    display: Display
    session: int = 7
    first_sample: int = 0
    sensing_clock: Clock = ahead_ns
    display_clock: Clock = true_time_ns
    delays_ns: Callable[[int, int], list[int]] = lambda _, __: [WAY_NS]
    control_delay_ns: Callable[[int], int | None] = lambda _: WAY_NS
    stream: StreamDescription = field(default_factory=lambda: description(bytes_per_sample=8))
    sends: bool = True
    frames: int = 0
    # What was wanted of the actuator, tick by tick: true time in ns, force in N, E in ns, strength.
    played: list[tuple[int, float, int, bool]] = field(default_factory=list)
    _arrivals: list[tuple[int, int, str, bytes]] = field(default_factory=list)
    _order: "itertools.count[int]" = field(default_factory=itertools.count)

    def run(self, from_ms: int, to_ms: int) -> None:
        """Let time pass: a frame is sent every 5 ms of it, the display ticks every ms."""
        for ms in range(from_ms, to_ms):
            true_ns = ms * MS
            if self.sends and ms % BATCH == 0:
                self.send(true_ns)
            self._arrive(true_ns)
            now_ns = self.display_clock(true_ns)
            felt = self.display.tick(now_ns)
            self.played.append((true_ns, felt.target_n, felt.playout_delay_ns, felt.scored))
            for request in self.display.requests(now_ns):
                match request:
                    case Hello() | ClockRequest():
                        self._later(true_ns, self.control_delay_ns(true_ns), request)

    def send(self, true_ns: int) -> None:
        """A frame is sent whose last sample is taken now."""
        taken_ns = [true_ns - (BATCH - 1 - i) * MS for i in range(BATCH)]
        values = np.array([[pulse_n(t_ns)] for t_ns in taken_ns])
        first = self.first_sample + self.frames * BATCH
        frame = Frame(self.session, first, self.sensing_clock(taken_ns[0]), MS, values)
        # What is sent to nobody arrives nowhere.
        if self.display.receiver.listening or self.display.receiver.frames[0]:
            for delay_ns in self.delays_ns(self.frames, true_ns):
                self.deliver(true_ns + delay_ns, "frame", encode_frame(frame))
        self.frames += 1

    def deliver(self, at_ns: int, kind: str, data: bytes) -> None:
        """Let a message arrive at a true time: a "frame" or "control"."""
        heapq.heappush(self._arrivals, (at_ns, next(self._order), kind, data))

    def errors_n(self, from_ms: int, to_ms: int) -> list[float]:
        """How far the force played was from the pulse of E ago, while at its full strength."""
        return [
            abs(force_n - pulse_n(true_ns - delay_ns))
            for true_ns, force_n, delay_ns, full in self.played
            if full and from_ms * MS <= true_ns < to_ms * MS
        ]

    def full_strength_ms(self, from_ms: int, to_ms: int) -> int:
        """For how many ms the pulse was at its full strength."""
        return sum(full for t_ns, _, _, full in self.played if from_ms * MS <= t_ns < to_ms * MS)

    def _later(self, true_ns: int, delay_ns: int | None, request: Hello | ClockRequest) -> None:
        """The answer to a request, delayed both ways, if it is not lost."""
        if delay_ns is None:
            return
        answered_ns = true_ns + delay_ns
        if isinstance(request, Hello):
            sent = self.first_sample + self.frames * BATCH
            reply = encode_control(Welcome(self.session, sent, self.stream))
        else:
            t_ns = self.sensing_clock(answered_ns)
            reply = encode_control(ClockReply(self.session, request.t1_ns, t_ns, t_ns))
        self.deliver(answered_ns + delay_ns, "control", reply)

    def _arrive(self, true_ns: int) -> None:
        now_ns = self.display_clock(true_ns)
        while self._arrivals and self._arrivals[0][0] <= true_ns:
            _, _, kind, data = heapq.heappop(self._arrivals)
            if kind == "frame":
                self.display.on_frame(data, now_ns)
            else:
                self.display.on_control(data, now_ns)
