import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.wire.messages import decode_frame, encode_frame
from protocol.wire.stream import Channel
from sensing_node.framer import Framer
from sensing_node.sources import SampleBlock
from tests.support.streams import MS, description

START_NS = 5_000_000_123


def block(first: int, count: int, channels: int = 1) -> SampleBlock:
    """Sample number i has the values i, i + 0.25, ... and is of START_NS + i ms."""
    values = np.arange(first, first + count, dtype=np.float64)[:, np.newaxis]
    return SampleBlock(START_NS + first * MS, MS, values + 0.25 * np.arange(channels))


@given(st.lists(st.integers(0, 40), max_size=12), st.integers(1, 9))
def test_samples_are_numbered_and_timed_without_gaps(sizes: list[int], batch: int) -> None:
    framer = Framer(description(batch=batch), session=42)
    sent = 0
    for size in sizes:
        frames = framer.frames(block(sent, size))
        for frame in frames:
            assert frame.session == 42
            assert frame.first_sample == sent
            assert frame.t_first_ns == START_NS + sent * MS
            assert frame.period_ns == MS
            assert frame.values[:, 0].tolist() == list(range(sent, sent + len(frame.values)))
            sent += len(frame.values)
        # Only the last frame of a block may be short of a batch.
        assert [len(frame.values) for frame in frames[:-1]] == [batch] * (len(frames) - 1)
        assert all(1 <= len(frame.values) <= batch for frame in frames)
    assert sent == sum(sizes) == framer.samples_sent


@pytest.mark.parametrize(("width", "dtype"), [(4, "<f4"), (8, "<f8")])
def test_samples_are_as_wide_as_described(width: int, dtype: str) -> None:
    framer = Framer(description(bytes_per_sample=width), session=1)
    (frame,) = framer.frames(SampleBlock(START_NS, MS, np.array([[0.1], [0.2]])))
    assert frame.values.dtype == np.dtype(dtype)
    assert frame.values[:, 0].tolist() == np.array([0.1, 0.2], dtype).tolist()


def test_the_largest_frame_passes_the_wire_as_it_is() -> None:
    stream = description(batch=4096, bytes_per_sample=8)
    (frame,) = Framer(stream, session=(1 << 62) - 1).frames(block(0, 4096))
    received = decode_frame(encode_frame(frame))
    assert received[:4] == frame[:4]
    np.testing.assert_array_equal(received.values, frame.values)


def test_channels_stay_side_by_side() -> None:
    stream = description(channels=tuple(Channel(name) for name in "abc"))
    frames = Framer(stream, session=1).frames(block(0, 7, channels=3))
    assert [frame.values.shape for frame in frames] == [(5, 3), (2, 3)]
    assert frames[1].values[0].tolist() == [5.0, 5.25, 5.5]
