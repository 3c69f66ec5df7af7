from collections.abc import Iterable

import numpy as np
import pytest

from telepulse.sample_queue import HOLD_NS, FrameReorderer, SampleQueue
from tests.support.telemetry_publisher import BATCH, MS, numbered_frame

AHEAD_NS = -(10**18)


def taken(reorderer: FrameReorderer, numbers: Iterable[int], now_ns: int = 0) -> list[int]:
    return [
        frame.first_sample // BATCH
        for number in numbers
        for frame in reorderer.take(numbered_frame(number), now_ns)
    ]


def test_frames_that_overtook_others_wait_for_them() -> None:
    reorderer = FrameReorderer()
    assert taken(reorderer, [7]) == [7]
    assert taken(reorderer, [10, 9]) == []
    assert taken(reorderer, [8]) == [8, 9, 10]
    assert reorderer.lost == 0


def test_a_frame_that_does_not_arrive_in_time_is_lost_and_left_out_when_it_arrives() -> None:
    reorderer = FrameReorderer()
    assert taken(reorderer, [0, 2]) == [0]
    assert taken(reorderer, [3], HOLD_NS - MS) == []
    assert taken(reorderer, [4], HOLD_NS) == [2, 3, 4]
    assert reorderer.lost == BATCH
    assert taken(reorderer, [1, 5], HOLD_NS) == [5]
    assert reorderer.lost == BATCH
    assert taken(reorderer, [8, 7], HOLD_NS) == []
    assert [frame.first_sample // BATCH for frame in reorderer.flush()] == [7, 8]
    assert reorderer.lost == 2 * BATCH


def queued(queue: SampleQueue, numbers: Iterable[int], now_ns: int = 0) -> None:
    for number in numbers:
        queue.add(numbered_frame(number), now_ns, AHEAD_NS)


def test_samples_come_in_blocks_of_any_length_in_their_order() -> None:
    queue = SampleQueue()
    queued(queue, [0, 2, 1, 3])
    assert queue.waiting == 4 * BATCH
    expected = np.concatenate([numbered_frame(number).values for number in range(4)])
    first, second = queue.take(7), queue.take(100)
    assert first is not None
    assert second is not None
    assert (first.first_sample, len(first.values), second.first_sample) == (0, 7, 7)
    np.testing.assert_array_equal(np.concatenate([first.values, second.values]), expected)
    t_ns = np.concatenate([first.t_ns, second.t_ns])
    assert set(np.diff(t_ns).tolist()) == {numbered_frame(0).period_ns}
    assert first.unix_s[0] == pytest.approx((numbered_frame(0).t_first_ns - AHEAD_NS) * 1e-9)
    assert queue.take(1) is None


def test_lost_samples_are_nan_and_counted() -> None:
    queue = SampleQueue()
    queued(queue, [0])
    queued(queue, [3], HOLD_NS)
    queued(queue, [4], 2 * HOLD_NS)
    block = queue.take(1_000)
    assert block is not None
    assert len(block.values) == 5 * BATCH
    lost = np.isnan(block.values[:, 0])
    assert lost.tolist() == BATCH * [False] + 2 * BATCH * [True] + 2 * BATCH * [False]
    assert queue.lost == 2 * BATCH
    assert (np.diff(block.unix_s) > 0).all()


def test_what_is_not_read_in_time_is_dropped_and_counted() -> None:
    kept = 3 * BATCH
    queue = SampleQueue(kept * numbered_frame(0).period_ns * 1e-9)
    queued(queue, range(5))
    assert (queue.waiting, queue.dropped) == (kept, 2 * BATCH)
    block = queue.take(1_000)
    assert block is not None
    assert block.first_sample == 2 * BATCH


def test_a_block_ends_with_its_session() -> None:
    queue = SampleQueue()
    queued(queue, [0, 2])
    queue.add(numbered_frame(7)._replace(session=8), 0, AHEAD_NS)
    assert queue.session_ends
    blocks = [queue.take(1_000), queue.take(1_000)]
    assert [block and len(block.values) for block in blocks] == [3 * BATCH, BATCH]
    assert queue.lost == BATCH
