import numpy as np

from protocol.wire.messages import Frame
from protocol.wire.stream import StreamDescription
from sensing_node.framer import Framer
from sensing_node.sources import SampleBlock
from sensing_node.sources.live import feed_of
from sensing_node.sources.replay import ReplaySource
from tests.support.streams import MS, description

START_NS = 7_000 * MS


def frame(first: int, count: int = 5, late_ns: int = 0, period_ns: int = MS) -> Frame:
    values = (np.arange(first, first + count)[:, np.newaxis] * 0.1).astype("<f4")
    return Frame(1, first, 1_000 * MS + first * MS + late_ns, period_ns, values)


def played(*frames: Frame) -> list[SampleBlock]:
    """All blocks, read at the instants at which the source says they are due."""
    replay = ReplaySource(description(), frames)
    assert feed_of(replay, START_NS) is replay
    blocks = []
    while not replay.exhausted:
        due_ns = replay.due_ns(1)
        assert replay.read(due_ns - 1) is None
        block = replay.read(due_ns)
        if block is not None:
            blocks.append(block)
    assert replay.read(1 << 62) is None
    return blocks


def sent(blocks: list[SampleBlock], stream: StreamDescription) -> list[Frame]:
    framer = Framer(stream, session=9)
    return [frame for block in blocks for frame in framer.frames(block)]


def test_it_sends_the_same_frames_from_a_new_start() -> None:
    frames = [frame(20), frame(25, 3), frame(28)]
    for before, after in zip(frames, sent(played(*frames), description()), strict=True):
        assert after.values.tobytes() == before.values.tobytes()
        assert after.first_sample == before.first_sample - 20
        assert after.t_first_ns - START_NS == before.t_first_ns - frames[0].t_first_ns


def test_jitter_of_a_sensors_times_is_kept() -> None:
    blocks = played(frame(0), frame(5, late_ns=70_000, period_ns=MS + 300))
    assert blocks[1].t_first_ns - blocks[0].t_first_ns == 5 * MS + 70_000
    assert blocks[1].period_ns == MS + 300


def test_samples_that_the_recording_lacks_keep_their_numbers() -> None:
    blocks = played(frame(0), frame(25), frame(30))
    assert [block.missing for block in blocks] == [0, 20, 0]
    assert [f.first_sample for f in sent(blocks, description())] == [0, 25, 30]


def test_what_a_frame_repeats_is_left_out() -> None:
    blocks = played(frame(0), frame(0, 5), frame(3), frame(4, 2))
    values = np.concatenate([block.values[:, 0] for block in blocks])
    np.testing.assert_array_equal(values.astype("<f4"), frame(0, 8).values[:, 0])
    assert blocks[1].t_first_ns - blocks[0].t_first_ns == 5 * MS


def test_of_no_frames_it_is_at_its_end() -> None:
    assert played() == []
