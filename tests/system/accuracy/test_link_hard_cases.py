"""The whole display, in virtual time, with the worst behaviour of links and peers."""

import heapq
import itertools
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from random import Random

import numpy as np
import pytest

from display_node.display import Display
from protocol.summary.fields import SampleCounts
from protocol.wire.description import StreamDescription
from protocol.wire.messages import (
    Bye,
    ControlMessage,
    Frame,
    encode_control,
    encode_frame,
)
from tests.support.nodes import assert_accounted as assert_closed
from tests.support.sender import AHEAD_NS, MS, Sender, display
from tests.support.streams import description

HOUR_NS = 3_600_000 * MS
BATCH = 5
WAY_NS = 20 * MS

# Half a microstep, and the error of linear interpolation over 1 ms.
EXACT_N = 1e-4

Clock = Callable[[int], int]
"""Clock of a host: its time at a true time, both in ns."""


def pulse_n(true_ns: float) -> float:
    """Return the force at the wrist in N, with 1.2 beats a second."""
    return 0.3 + 0.1 * math.sin(2 * math.pi * 1.2 * true_ns * 1e-9)


@dataclass
class VirtualLink:
    """Sensing node, display, and the link between them.

    delays_ns: of each copy of a frame that arrives, by the frame's number and time of sending.
    sensing_clock: by default 5 s ahead.
    """

    display: Display
    session: int = 7
    first_sample: int = 0
    sensing_clock: Clock = lambda true_ns: true_ns + AHEAD_NS
    display_clock: Clock = lambda true_ns: true_ns
    delays_ns: Callable[[int, int], list[int]] = lambda _, __: [WAY_NS]
    control_delay_ns: Callable[[int], int | None] = lambda _: WAY_NS
    stream: StreamDescription = field(default_factory=lambda: description(bytes_per_sample=8))
    sends: bool = True
    frames: int = 0
    # Of each tick: true time in ns, target force in N, E in ns, and whether at full strength.
    played: list[tuple[int, float, int, bool]] = field(default_factory=list)
    _arrivals: list[tuple[int, int, str, bytes]] = field(default_factory=list)
    _order: "itertools.count[int]" = field(default_factory=itertools.count)

    def run(self, from_ms: int, to_ms: int) -> None:
        """Advance the time: send a frame every 5 ms, and tick every ms."""
        for ms in range(from_ms, to_ms):
            true_ns = ms * MS
            if self.sends and ms % BATCH == 0:
                self.send(true_ns)
            self._arrive(true_ns)
            now_ns = self.display_clock(true_ns)
            while self.display.work():
                pass
            felt = self.display.tick(now_ns)
            self.played.append((true_ns, felt.target_n, felt.playout_delay_ns, felt.full))
            for request in self.display.requests(now_ns):
                self._answer(true_ns, self.control_delay_ns(true_ns), request)

    def send(self, true_ns: int) -> None:
        """Send a frame whose last sample is taken now."""
        taken_ns = [true_ns - (BATCH - 1 - i) * MS for i in range(BATCH)]
        values = np.array([[pulse_n(t_ns)] for t_ns in taken_ns])
        first = self.first_sample + self.frames * BATCH
        frame = Frame(self.session, first, self.sensing_clock(taken_ns[0]), MS, values)
        # Before the display has subscribed, no frame arrives.
        if self.display.receiver.accepts_frames or self.display.receiver.frames[0]:
            for delay_ns in self.delays_ns(self.frames, true_ns):
                self.deliver(true_ns + delay_ns, "frame", encode_frame(frame))
        self.frames += 1

    def deliver(self, at_ns: int, kind: str, data: bytes) -> None:
        """Let a message of the kind "frame" or "control" arrive at a true time."""
        heapq.heappush(self._arrivals, (at_ns, next(self._order), kind, data))

    def errors_n(self, from_ms: int, to_ms: int) -> list[float]:
        """Return the errors against the pulse of E ago, at full strength."""
        return [
            abs(force_n - pulse_n(true_ns - delay_ns))
            for true_ns, force_n, delay_ns, full in self.played
            if full and from_ms * MS <= true_ns < to_ms * MS
        ]

    def full_strength_ms(self, from_ms: int, to_ms: int) -> int:
        """Return the number of ms at full strength."""
        return sum(full for t_ns, _, _, full in self.played if from_ms * MS <= t_ns < to_ms * MS)

    def assert_played(self, from_ms: int, to_ms: int, within_n: float = EXACT_N) -> None:
        """Assert that the pulse was at full strength all the time, with errors below a bound."""
        assert self.full_strength_ms(from_ms, to_ms) == to_ms - from_ms
        assert max(self.errors_n(from_ms, to_ms)) < within_n

    def _answer(self, true_ns: int, delay_ns: int | None, request: ControlMessage) -> None:
        """Answer a request, delayed both ways, unless it is lost."""
        if delay_ns is None:
            return
        answered_ns = true_ns + delay_ns
        sender = Sender(self.session, self.stream, self.first_sample + self.frames * BATCH)
        reply = sender.answer(request, self.sensing_clock(answered_ns) - AHEAD_NS)
        if reply is not None:
            self.deliver(answered_ns + delay_ns, "control", reply)

    def _arrive(self, true_ns: int) -> None:
        now_ns = self.display_clock(true_ns)
        while self._arrivals and self._arrivals[0][0] <= true_ns:
            _, _, kind, data = heapq.heappop(self._arrivals)
            if kind == "frame":
                self.display.on_frame(data, now_ns)
            else:
                self.display.on_control(data, now_ns)


def assert_accounted(link: VirtualLink) -> SampleCounts:
    """Assert that each sample has one outcome or was before joining, and none is counted twice."""
    link.sends = False
    end_ms = link.played[-1][0] // MS + 1
    sent = link.first_sample + link.frames * BATCH
    bye = encode_control(Bye(link.session, sent))
    link.deliver(end_ms * MS + WAY_NS, "control", bye)
    link.run(end_ms, end_ms + 2000)
    samples = link.display.summary().samples
    assert link.display.over
    assert samples.sent is not None
    assert_closed(asdict(samples))
    assert samples.sent + (samples.before_joining or 0) == sent
    return samples


def test_frames_beyond_the_largest_sequence_number_are_refused() -> None:
    last = 2**53
    link = VirtualLink(display(), first_sample=last - 2000)
    link.run(0, 3000)
    assert link.full_strength_ms(1500, 2000) == 500
    # The target force falls to 0 N.
    assert link.display.summary().rejected == {"malformed": 3000 // BATCH - 2000 // BATCH - 4}
    assert link.display.state == "stale"
    assert link.played[-1][1] == 0


def test_a_new_session_is_played_while_frames_of_the_last_one_still_arrive() -> None:
    # Frames of the old session arrive over a slower path, between those of the new one.
    slow = [2000 * MS]
    link = VirtualLink(display(paths=2), delays_ns=lambda _, __: [WAY_NS, *slow])
    link.run(0, 3000)
    link.session, link.frames, slow[:] = 8, 0, []
    link.run(3000, 8000)
    assert link.display.receiver.sessions == 2
    link.assert_played(4200, 8000, within_n=1e-2)
    assert link.display.summary().rejected["session"] > 1900 // BATCH


@pytest.mark.parametrize("frames", [1, 2, 10])
def test_a_stream_of_one_frame_is_accounted_for(frames: int) -> None:
    link = VirtualLink(display())
    link.sends = False
    link.run(0, 1000)
    for number in range(frames):
        link.run(1000 + BATCH * number, 1000 + BATCH * (number + 1))
        link.send((1000 + BATCH * number) * MS)
    samples = assert_accounted(link)
    assert samples.sent == frames * BATCH
    assert samples.lost == 0


def test_irregular_sample_periods_are_played_at_their_times() -> None:
    random = Random(5)
    link = VirtualLink(display(compensation_ns=60 * MS))
    link.sends = False
    taken_ns, first = 0, 0
    while taken_ns < 5000 * MS:
        count = random.randint(1, BATCH)
        period_ns = random.randint(MS // 2, 2 * MS)
        times_ns = [taken_ns + i * period_ns for i in range(count)]
        values = np.array([[pulse_n(t_ns)] for t_ns in times_ns])
        data = encode_frame(Frame(7, first, taken_ns + AHEAD_NS, period_ns, values))
        link.deliver(times_ns[-1] + WAY_NS, "frame", data)
        first, taken_ns = first + count, times_ns[-1] + random.randint(MS // 2, 2 * MS)
    link.run(0, 5000)
    assert link.display.summary().rejected.keys() <= {"before_welcome", "before_clock"}
    link.assert_played(1000, 5000)


@pytest.mark.parametrize("cut_ms", [5000, 10_000])
def test_frames_that_queued_during_a_cut_are_late_when_they_arrive_at_once(cut_ms: int) -> None:
    back_ms = 3000 + cut_ms

    def queued(_: int, true_ns: int) -> list[int]:
        waiting_ns = back_ms * MS - true_ns if 3000 * MS <= true_ns < back_ms * MS else 0
        return [WAY_NS + waiting_ns]

    link = VirtualLink(
        display(),
        delays_ns=queued,
        control_delay_ns=lambda ns: None if 3000 * MS <= ns < back_ms * MS else WAY_NS,
    )
    link.run(0, back_ms + 2000)
    # The target is 0 N soon after the cut, and later always the pulse of E ago.
    assert link.full_strength_ms(3200, back_ms) == 0
    assert {force_n for t_ns, force_n, _, _ in link.played if 3500 <= t_ns // MS < back_ms} == {0}
    assert link.full_strength_ms(back_ms + 1000, back_ms + 2000) == 1000
    after_ns = [delay for t_ns, _, delay, full in link.played if t_ns >= back_ms * MS and full]
    assert max(after_ns) < 60 * MS
    assert max(link.errors_n(back_ms, back_ms + 2000)) < 1e-3
    samples = assert_accounted(link)
    assert samples.lost == 0
    assert abs((samples.late or 0) - cut_ms) < 100


@pytest.mark.parametrize("ppm", [-500, 500])
@pytest.mark.parametrize("host", ["sensing", "display"])
def test_a_skew_of_500_ppm_is_not_felt(host: str, ppm: int) -> None:
    link = VirtualLink(display())
    setattr(link, f"{host}_clock", lambda ns: ns + 2 * HOUR_NS + ns * ppm // 1_000_000)
    link.run(0, 15_000)
    assert link.full_strength_ms(1500, 15_000) == 13_500
    assert max(link.errors_n(5000, 15_000)) < 1e-3
    samples = assert_accounted(link)
    assert (samples.lost, link.display.summary().rejected) == (0, {})


@pytest.mark.parametrize(
    ("shift_ms", "skipped"),
    [(900, 0), (10_000, 0), (-900, 0), (-100_000, 0), (0, 1000), (-3, 0)],
    ids=["future", "far future", "past", "far past", "skipped numbers", "overlapping times"],
)
def test_the_pulse_returns_after_one_frame_of_a_false_time(shift_ms: int, skipped: int) -> None:
    link = VirtualLink(display())
    link.run(0, 3000)
    first = link.frames * BATCH + skipped
    t_ns = 3000 * MS + AHEAD_NS + shift_ms * MS
    frame = Frame(7, first, t_ns, MS, np.full((BATCH, 1), 2.0))
    link.deliver(3000 * MS + WAY_NS, "frame", encode_frame(frame))
    link.frames += 1
    link.run(3000, 8000)
    assert max(force_n for _, force_n, _, _ in link.played) <= 2.5
    link.assert_played(6000, 8000, within_n=1e-3)
    assert link.display.receiver.sessions == 1
