"""A sensing node that lies: whatever it says in well-formed messages, no sample is unaccounted
for, and the display keeps no more than it may."""

import tracemalloc

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from display_node.reception.jitter_buffer import KEEP_SAMPLES, MAX_AHEAD_SAMPLES, JitterBuffer
from fuzz.stream_play import BATCH, StreamPlay
from protocol.errors import WireError
from tests.support.frames import frame

MOST_BYTES = 30_000_000
near = st.integers(-20, 20)
far = st.sampled_from([-(10**15), -70_000, -1001, 1001, 70_000, 10**9, 2**52]) | near


class LyingNode(RuleBasedStateMachine):
    """Each step checks the account (fuzz/stream_play.py)."""

    def __init__(self) -> None:
        super().__init__()
        self.play = StreamPlay()
        self.joins()

    @rule(ms=st.integers(0, 400))
    def time_passes(self, ms: int) -> None:
        self.play.pass_time(ms)

    @precondition(lambda self: not self.play.receiver.listening)
    @rule()
    def joins(self) -> None:
        self.play.welcome(1)
        for _ in range(4):
            self.play.pass_time(20)
            self.play.clock_reply(0)

    @rule(frames=st.integers(1, 40))
    def streams(self, frames: int) -> None:
        for _ in range(frames):
            self.play.frame(0)
            self.play.pass_time(BATCH)

    @rule(off=far, count=st.integers(1, 12))
    def frame_that_lies(self, off: int, count: int) -> None:
        self.play.frame(off, count)

    @rule(off=near | st.integers(-(10**6), 10**6))
    def frame_of_another_time(self, off: int) -> None:
        self.play.frame_of_another_time(off)

    @rule(off=near | st.integers(-(10**6), 10**6), times=st.integers(1, 5))
    def clock_that_lies(self, off: int, times: int) -> None:
        for _ in range(times):
            self.play.pass_time(50)
            self.play.clock_reply(off)

    @rule(off=st.integers(-1, 2))
    def welcomes_again(self, off: int) -> None:
        self.play.welcome(off)

    @rule(off=far)
    def says_bye(self, off: int) -> None:
        self.play.bye(off)


TestLyingNode = LyingNode.TestCase
TestLyingNode.settings = settings(max_examples=40, stateful_step_count=25)


def test_a_buffer_that_is_flooded_ahead_of_its_time_is_bounded() -> None:
    buffer = JitterBuffer(0)
    most = KEEP_SAMPLES + MAX_AHEAD_SAMPLES
    tracemalloc.start()
    try:
        causes = [_refused(buffer, 500 * number) for number in range(2 * most // 500)]
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    taken = MAX_AHEAD_SAMPLES // 500
    assert causes == [None] * taken + ["overflow"] * (len(causes) - taken)
    assert buffer.waiting == 500 * taken
    assert peak < MOST_BYTES


def _refused(buffer: JitterBuffer, first: int) -> str | None:
    """The cause for which 500 samples are refused."""
    try:
        buffer.put(frame(first, 500))
    except WireError as error:
        return error.cause
    return None
