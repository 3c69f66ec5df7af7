from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from protocol.wire.messages import Frame, decode_frame, encode_frame
from protocol.wire.stream import Channel
from pulse_sensors.samples import SampleBlock
from pulse_sensors.sensor import Sensor
from sensing_node.feeds import Framer, LiveSource, PacedSource, ReplaySource, feed_of
from tests.support.streams import MS, description, synthetic

START_NS = 77_000_000_123


def block(
    first: float, values: NDArray[np.float64], missing: int = 0, period_ms: float = 1
) -> SampleBlock:
    """Return samples from `first` ms after the start on."""
    first_ns, count = START_NS + round(first * MS), len(values)
    end_ns = first_ns + round(count * period_ms * MS)
    return SampleBlock(values.reshape(count, -1), missing, first_ns, end_ns)


def counting(first: int, count: int, channels: int = 1) -> SampleBlock:
    """Return samples of which number i has the values i, i + 0.25, ... at START_NS + i ms."""
    numbers = np.arange(first, first + count, dtype=np.float64)
    return block(first, numbers[:, np.newaxis] + 0.25 * np.arange(channels))


class CountingSource:
    """A source of `length` samples; number i has the value i."""

    channels = (Channel("pulse"),)
    period_ns = MS

    def __init__(self, length: int) -> None:
        self._left = np.arange(length, dtype=np.float64)[:, np.newaxis]

    def take(self, count: int) -> NDArray[np.float64]:
        taken, self._left = self._left[:count], self._left[count:]
        return taken


def paced(length: int = 1000) -> PacedSource:
    return PacedSource(CountingSource(length), START_NS)


def numbers(found: SampleBlock | None) -> list[float]:
    return [] if found is None else found.force_n


@pytest.mark.parametrize(
    ("after_ns", "count"),
    [(-MS, 0), (-1, 0), (0, 1), (MS - 1, 1), (MS, 2), (9 * MS, 10), (100 * MS - 1, 100)],
)
def test_one_sample_is_due_each_period(after_ns: int, count: int) -> None:
    assert numbers(paced().read(START_NS + after_ns)) == list(range(count))


@given(st.lists(st.integers(-MS, 20 * MS), max_size=20))
def test_every_sample_comes_once_at_its_time_with_any_reads(after_ns: list[int]) -> None:
    source, seen = paced(), 0
    # The clock may also step back.
    for after in (*sorted(after_ns), 3 * MS):
        found = source.read(START_NS + after)
        assert numbers(found) == list(range(seen, max(seen, after // MS + 1)))
        if found is not None:
            assert found.first_ns == START_NS + seen * MS
            assert found.period_ns == MS
            seen += len(found.values)
        assert source.due_ns(5) == START_NS + (seen + 4) * MS


@pytest.mark.parametrize(("length", "reads"), [(7, [5, 2, 0]), (5, [5, 0])])
def test_a_source_returns_its_rest_and_is_exhausted(length: int, reads: list[int]) -> None:
    source = paced(length)
    for read in reads:
        assert not source.exhausted or not read
        assert len(numbers(source.read(source.due_ns(5)))) == read
    assert source.exhausted
    assert source.read(START_NS + 1000 * MS) is None


class GivenSensor(Sensor):
    """A sensor with given blocks in each poll."""

    def __init__(self, *polls: list[SampleBlock]) -> None:
        self.period_ns, self.channels = MS, (Channel("cun"), Channel("guan"))
        self._polls = list(polls)

    def poll(self) -> list[SampleBlock]:
        return self._polls.pop(0) if self._polls else []

    @property
    def rejected(self) -> Counter[str]:
        return Counter(crc=3)

    def faults(self) -> list[str]:
        return ["no sample came"]


def live(*blocks: SampleBlock) -> LiveSource:
    return LiveSource(GivenSensor(list(blocks)))


def test_contiguous_blocks_of_a_sensor_are_joined() -> None:
    source = live(block(5, np.array([0.1, 0.2])), block(7, np.array([0.3]), period_ms=1.3))
    found = source.read(0)
    assert found is not None
    assert (found.first_ns, found.missing) == (START_NS + 5 * MS, 0)
    assert found.period_ns == round(3.3 / 3 * MS)
    assert found.times_ns == [START_NS + 5 * MS + at_ns for at_ns in (0, 1_100_000, 2_200_000)]
    assert found.values.tolist() == [[0.1], [0.2], [0.3]]
    assert source.read(0) is None


def test_a_gap_of_a_sensor_ends_a_block_and_keeps_its_sequence_numbers() -> None:
    pieces = [np.array([0.1, 0.2]), np.array([0.3]), np.array([0.4])]
    source = live(block(5, pieces[0]), block(17, pieces[1], missing=10), block(18, pieces[2]))
    framer, frames = Framer(description(batch=5), 1), list[Frame]()
    while (found := source.read(0)) is not None:
        frames += framer.frames(found)
    assert [(f.first_sample, f.t_first_ns - START_NS, len(f.values)) for f in frames] == [
        (0, 5 * MS, 2),
        (12, 17 * MS, 2),
    ]
    assert framer.samples_sent == 14


def test_a_live_sensor_is_its_own_feed_with_its_counts_and_faults() -> None:
    source = live()
    assert feed_of(source, 7) is source
    assert isinstance(feed_of(synthetic(), 7), PacedSource)
    assert source.due_ns(1) == MS
    source.read(50 * MS)
    assert source.due_ns(5) == 55 * MS
    assert not source.exhausted
    assert (source.rejected, source.faults()) == ({"crc": 3}, ["no sample came"])


def frame(first: int, count: int = 5, late_ns: int = 0, period_ns: int = MS) -> Frame:
    values = (np.arange(first, first + count)[:, np.newaxis] * 0.1).astype("<f4")
    return Frame(1, first, 1_000 * MS + first * MS + late_ns, period_ns, values)


def replayed(*frames: Frame) -> list[SampleBlock]:
    """Return all blocks, each read when it is due."""
    replay = ReplaySource(description(), frames)
    assert feed_of(replay, START_NS) is replay
    blocks = []
    while not replay.exhausted:
        due_ns = replay.due_ns(1)
        assert replay.read(due_ns - 1) is None
        found = replay.read(due_ns)
        blocks += [] if found is None else [found]
    assert replay.read(1 << 62) is None
    return blocks


def framed(blocks: list[SampleBlock]) -> list[Frame]:
    framer = Framer(description(), session=9)
    return [frame for found in blocks for frame in framer.frames(found)]


def test_a_replay_returns_the_same_frames_from_a_new_start() -> None:
    frames = [frame(20), frame(25, 3), frame(28)]
    for before, after in zip(frames, framed(replayed(*frames)), strict=True):
        assert after.values.tobytes() == before.values.tobytes()
        assert after.first_sample == before.first_sample - 20
        assert after.t_first_ns - START_NS == before.t_first_ns - frames[0].t_first_ns


def test_a_replay_keeps_jitter_and_gaps_and_omits_repetitions() -> None:
    first, second = replayed(frame(0), frame(5, late_ns=70_000, period_ns=MS + 300))
    assert second.first_ns - first.first_ns == 5 * MS + 70_000
    assert second.period_ns == MS + 300
    gap = replayed(frame(0), frame(25), frame(30))
    assert [found.missing for found in gap] == [0, 20, 0]
    assert [found.first_sample for found in framed(gap)] == [0, 25, 30]
    repeated = replayed(frame(0), frame(0, 5), frame(3), frame(4, 2))
    values = np.concatenate([found.values[:, 0] for found in repeated])
    np.testing.assert_array_equal(values.astype("<f4"), frame(0, 8).values[:, 0])
    assert repeated[1].first_ns - repeated[0].first_ns == 5 * MS
    assert replayed() == []


@given(st.lists(st.integers(0, 40), max_size=12), st.integers(1, 9))
def test_samples_are_numbered_and_timed_without_gaps(sizes: list[int], batch: int) -> None:
    framer = Framer(description(batch=batch), session=42)
    sent = 0
    for size in filter(None, sizes):
        frames = framer.frames(counting(sent, size))
        for made in frames:
            assert made.session == 42
            assert made.first_sample == sent
            assert made.t_first_ns == START_NS + sent * MS
            assert made.period_ns == MS
            assert made.values[:, 0].tolist() == list(range(sent, sent + len(made.values)))
            sent += len(made.values)
        # Only the last frame of a block may be shorter than a batch.
        assert [len(made.values) for made in frames[:-1]] == [batch] * (len(frames) - 1)
        assert all(1 <= len(made.values) <= batch for made in frames)
    assert sent == sum(sizes) == framer.samples_sent


@pytest.mark.parametrize(("width", "dtype"), [(4, "<f4"), (8, "<f8")])
def test_samples_have_the_described_width(width: int, dtype: str) -> None:
    framer = Framer(description(bytes_per_sample=width), session=1)
    (made,) = framer.frames(block(0, np.array([0.1, 0.2])))
    assert made.values.dtype == np.dtype(dtype)
    assert made.values[:, 0].tolist() == np.array([0.1, 0.2], dtype).tolist()


def test_the_largest_frame_can_be_sent() -> None:
    stream = description(batch=4096, bytes_per_sample=8)
    (made,) = Framer(stream, session=(1 << 62) - 1).frames(counting(0, 4096))
    received = decode_frame(encode_frame(made))
    assert received[:4] == made[:4]
    np.testing.assert_array_equal(received.values, made.values)


def test_each_channel_is_a_column() -> None:
    stream = description(channels=tuple(Channel(name) for name in "abc"))
    frames = Framer(stream, session=1).frames(counting(0, 7, channels=3))
    assert [made.values.shape for made in frames] == [(5, 3), (2, 3)]
    assert frames[1].values[0].tolist() == [5.0, 5.25, 5.5]
