import numpy as np
import pytest

from telepulse.reports.studies.playout_links import DelayTrace, in_order
from telepulse.reports.studies.playout_rules import FixedDelay, felt_delays_ns, play

MS = 1_000_000


class Told:
    """A rule that says the next of a row of delays after every frame."""

    def __init__(self, *delays_ms: float) -> None:
        self._delays_ms = list(delays_ms)
        self.delay_ns: int | None = None

    def observe(self, delay_ns: int, now_ns: int) -> None:
        self.delay_ns = round(self._delays_ms.pop(0) * MS)


def felt_ms(trace: DelayTrace, *asked_ms: float) -> list[float]:
    asked_ns = np.array([round(ms * MS) for ms in asked_ms])
    felt: list[float] = (felt_delays_ns(trace, asked_ns) / MS).tolist()
    return felt


def test_a_constant_delay_is_felt_and_what_is_above_it_is_late() -> None:
    delays_ms = np.random.default_rng(1).normal(20, 3, 2000)
    trace = in_order("", delays_ms)
    played = play(FixedDelay(round(7 * MS)), trace)
    used_ns = trace.delay_ns[0] + 7 * MS
    assert played.delay_ms == pytest.approx(used_ns / MS)
    assert played.late == (trace.delay_ns > used_ns).mean()
    assert 0 < played.late < 0.2


def test_a_delay_that_grows_for_a_late_frame_does_not_save_what_was_due_already() -> None:
    # The frame sent at 10 ms arrives at 60 with the next eight.
    trace = in_order("", np.array([10.0, 10, 50, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10]))
    asked_ms = [12.0, 12, *[60.0] * 12]
    felt = np.array(felt_ms(trace, *asked_ms))
    late = trace.delay_ns / MS > felt
    # By 60 ms all that was sent until 48 had been due.
    assert np.flatnonzero(late).tolist() == [2, 3, 4, 5, 6, 7, 8, 9]
    assert felt[10:].tolist() == [60.0] * 4


def test_a_delay_that_shrinks_plays_what_it_passes_over_at_once() -> None:
    trace = in_order("", np.full(8, 10.0))
    # At 20 ms, with the third frame, 40 ms become 11: what was sent until 9 ms is due at once.
    felt = felt_ms(trace, 40, 40, 11, 11, 11, 11, 11, 11)
    assert felt == [20, 15, 11, 11, 11, 11, 11, 11]


def test_a_warped_playout_goes_up_by_20_ms_a_second() -> None:
    frames = 800
    trace = in_order("", np.full(frames, 10.0))
    at_once = play(Told(10, *[50.0] * (frames - 1)), trace)
    warped = play(Told(10, *[50.0] * (frames - 1)), trace, warped=True)
    assert at_once.delay_ms == pytest.approx(50, abs=0.2)
    # 40 ms take 2 s of the 4, in which 98 % of 400 frames are played, 20 ms off on average; the
    # first is played before any of it.
    assert warped.delay_ms == pytest.approx(50 - 40 * (1 + 0.98 * 400 / 2) / frames, abs=0.01)
    assert warped.late == 0
