from collections.abc import Iterable

from telepulse.lsl_outlet.forwarder import HOLD_NS, FrameReorderer
from tests.support.telemetry_speaker import BATCH, MS, numbered_frame


def taken(in_order: FrameReorderer, numbers: Iterable[int], now_ns: int = 0) -> list[int]:
    return [
        frame.first_sample // BATCH
        for number in numbers
        for frame in in_order.take(numbered_frame(number), now_ns)
    ]


def test_frames_that_overtook_others_wait_for_them() -> None:
    in_order = FrameReorderer()
    assert taken(in_order, [7]) == [7]
    assert taken(in_order, [10, 9]) == []
    assert taken(in_order, [8]) == [8, 9, 10]
    assert in_order.lost == 0


def test_what_does_not_come_in_time_is_lost_and_what_comes_then_is_left_out() -> None:
    in_order = FrameReorderer()
    assert taken(in_order, [0, 2]) == [0]
    assert taken(in_order, [3], HOLD_NS - MS) == []
    assert taken(in_order, [4], HOLD_NS) == [2, 3, 4]
    assert in_order.lost == BATCH
    assert taken(in_order, [1, 5], HOLD_NS) == [5]
    assert in_order.lost == BATCH
    assert taken(in_order, [8, 7], HOLD_NS) == []
    assert [frame.first_sample // BATCH for frame in in_order.rest()] == [7, 8]
    assert in_order.lost == 2 * BATCH
