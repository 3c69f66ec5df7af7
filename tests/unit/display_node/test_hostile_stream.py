"""A sensing node that sends false, well-formed messages: every sample is accounted for."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from fuzz.stream_play import BATCH, StreamPlay

near = st.integers(-20, 20)
far = st.sampled_from([-(10**15), -70_000, -1001, 1001, 70_000, 10**9, 2**52]) | near


class FalseNode(RuleBasedStateMachine):
    """Each step checks the account (fuzz/stream_play.py)."""

    def __init__(self) -> None:
        super().__init__()
        self.play = StreamPlay()
        self.joins()

    @rule(ms=st.integers(0, 400))
    def time_passes(self, ms: int) -> None:
        self.play.pass_time(ms)

    @precondition(lambda self: not self.play.receiver.accepts_frames)
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
    def frame_of_false_number(self, off: int, count: int) -> None:
        self.play.frame(off, count)

    @rule(off=near | st.integers(-(10**6), 10**6))
    def frame_of_another_time(self, off: int) -> None:
        self.play.frame_of_another_time(off)

    @rule(off=near | st.integers(-(10**6), 10**6), times=st.integers(1, 5))
    def false_clock(self, off: int, times: int) -> None:
        for _ in range(times):
            self.play.pass_time(50)
            self.play.clock_reply(off)

    @rule(off=st.integers(-1, 2))
    def welcomes_again(self, off: int) -> None:
        self.play.welcome(off)

    @rule(off=far)
    def ends(self, off: int) -> None:
        self.play.bye(off)


TestFalseNode = FalseNode.TestCase
TestFalseNode.settings = settings(max_examples=40, stateful_step_count=25)
