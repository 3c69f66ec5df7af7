"""Account of every sample of a sensing node that sends false but well-formed messages."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from fuzz.stream_play import BATCH, StreamPlay

near = st.integers(-20, 20)
far = st.sampled_from([-(10**15), -70_000, -1001, 1001, 70_000, 10**9, 2**52]) | near


class FalseNode(RuleBasedStateMachine):
    """Sensing node; `StreamPlay` checks the receiver's account at each step."""

    def __init__(self) -> None:
        super().__init__()
        self.play = StreamPlay()
        self.join()

    @rule(ms=st.integers(0, 400))
    def pass_time(self, ms: int) -> None:
        self.play.pass_time(ms)

    @precondition(lambda self: not self.play.receiver.accepts_frames)
    @rule()
    def join(self) -> None:
        self.play.welcome(1)
        for _ in range(4):
            self.play.pass_time(20)
            self.play.clock_reply(0)

    @rule(frames=st.integers(1, 40))
    def send_frames(self, frames: int) -> None:
        for _ in range(frames):
            self.play.frame(0)
            self.play.pass_time(BATCH)

    @rule(off=far, count=st.integers(1, 12))
    def send_frame_of_false_number(self, off: int, count: int) -> None:
        self.play.frame(off, count)

    @rule(off=near | st.integers(-(10**6), 10**6))
    def send_frame_of_another_time(self, off: int) -> None:
        self.play.frame_of_another_time(off)

    @rule(off=near | st.integers(-(10**6), 10**6), times=st.integers(1, 5))
    def reply_with_false_clock(self, off: int, times: int) -> None:
        for _ in range(times):
            self.play.pass_time(50)
            self.play.clock_reply(off)

    @rule(off=st.integers(-1, 2))
    def welcome_again(self, off: int) -> None:
        self.play.welcome(off)

    @rule(off=far)
    def end(self, off: int) -> None:
        self.play.bye(off)


TestFalseNode = FalseNode.TestCase
TestFalseNode.settings = settings(max_examples=20, stateful_step_count=25)
