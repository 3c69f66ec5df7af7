from collections.abc import Iterable

from telepulse.lsl_outlet import HOLD_NS, FrameReorderer
from tests.support.telemetry_publisher import BATCH, MS, numbered_frame


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
