import numpy as np
import zmq
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from protocol.wire.description import Channel
from protocol.wire.messages import Frame
from pulse_sensors.samples import SampleBlock
from pulse_sensors.sensor import Sensor
from sensing_node.feeds import Framer, LiveFeed, PacedFeed, ReplayFeed, feed_of
from sensing_node.node import MOST_BYTES, queue_limits
from tests.support.streams import MS, description

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


def paced(length: int = 1000) -> PacedFeed:
    return PacedFeed(CountingSource(length), START_NS)


def numbers(found: SampleBlock | None) -> list[float]:
    return [] if found is None else found.force_n


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


class GivenSensor(Sensor):
    """A sensor with given blocks in each poll."""

    def __init__(self, *polls: list[SampleBlock]) -> None:
        self.period_ns, self.channels = MS, (Channel("cun"), Channel("guan"))
        self._polls = list(polls)

    def poll(self) -> list[SampleBlock]:
        return self._polls.pop(0) if self._polls else []


def live(*blocks: SampleBlock) -> LiveFeed:
    return LiveFeed(GivenSensor(list(blocks)))


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
    assert framer.next_sample == 14


def frame(first: int, count: int = 5, late_ns: int = 0, period_ns: int = MS) -> Frame:
    values = (np.arange(first, first + count)[:, np.newaxis] * 0.1).astype("<f4")
    return Frame(1, first, 1_000 * MS + first * MS + late_ns, period_ns, values)


def replayed(*frames: Frame) -> list[SampleBlock]:
    """Return all blocks, each read when it is due."""
    replay = ReplayFeed(description(), frames)
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
    assert sent == sum(sizes) == framer.next_sample


def limits(period_ns: int, batch: int, channels: int = 1) -> dict[int, int]:
    names = tuple(Channel(f"c{number}") for number in range(channels))
    return queue_limits(description(period_ns=period_ns, batch=batch, channels=names))


def test_a_queue_holds_about_a_second_of_the_stream() -> None:
    assert limits(MS, 5)[zmq.SNDHWM] == 200
    assert limits(MS, 1)[zmq.SNDHWM] == 1000
    assert limits(1_000_000_000, 1)[zmq.SNDHWM] == 16
    # The kernel doubles the size; each small frame needs a packet of about a kilobyte.
    assert 200_000 < 2 * limits(MS, 5)[zmq.SNDBUF] < 250_000
    # Where a second needs more than Linux accepts, the kernel chooses.
    assert zmq.SNDBUF not in limits(1_000, 1000, channels=8)
    assert limits(100_000, 50, channels=4)[zmq.SNDBUF] <= MOST_BYTES
