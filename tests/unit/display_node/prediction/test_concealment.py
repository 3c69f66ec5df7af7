import math

import numpy as np
import pytest

from display_node.prediction import PredictorName
from display_node.prediction.concealment import (
    MOST_NS,
    Blend,
    Concealment,
    PulseSize,
    Trust,
    auto_delay_ns,
)
from protocol.wire.messages import Frame

MS = 1_000_000
T0_NS = 1_700_000_000_000_000_000


def straight(at_ms: float, slope: float = 0.01, offset: float = 0.0) -> list[float]:
    return [offset + slope * (at_ms + step) for step in range(4)]


def joined(smoothing: Blend, at_ms: float, path: list[float], newest_ms: float) -> list[float]:
    return smoothing.apply(path, T0_NS + round(at_ms * MS), T0_NS + round(newest_ms * MS))


def test_a_prediction_that_stays_is_left_alone() -> None:
    smoothing = Blend(MS)
    for at_ms in range(40, 80):
        path = straight(at_ms)
        assert joined(smoothing, at_ms, path, 0) == pytest.approx(path, abs=1e-12)


def test_new_data_makes_no_jump_and_replaces_the_prediction_exponentially() -> None:
    smoothing = Blend(MS)
    for at_ms in range(40, 45):
        before = joined(smoothing, at_ms, straight(at_ms), 0)
    # What was predicted was 0.1 too low, 44 ms ahead: time constant 0.2 × 44 ms.
    felt = [joined(smoothing, ms, straight(ms, offset=0.1), 5)[0] for ms in range(45, 145)]
    assert felt[0] == pytest.approx(before[1])
    missing = [0.1 + 0.01 * ms - value for ms, value in zip(range(45, 145), felt, strict=True)]
    for ticks in (1, 10, 50):
        assert missing[ticks] == pytest.approx(0.1 * math.exp(-ticks / (0.2 * 44)))


def test_a_path_predicts_the_force_of_the_next_ticks() -> None:
    smoothing = Blend(MS)
    joined(smoothing, 44, straight(44), 0)
    path = joined(smoothing, 45, straight(45, offset=0.1), 5)
    for tick in range(1, 4):
        at_ms = 45 + tick
        now = joined(smoothing, at_ms, straight(at_ms, offset=0.1), 5)
        assert now[0] == pytest.approx(path[tick])


@pytest.mark.parametrize("warp", [0.98, 1.02])
def test_a_warped_playout_is_no_jump(warp: float) -> None:
    smoothing = Blend(MS)
    for tick in range(100):
        path = straight(40 + warp * tick)
        assert joined(smoothing, 40 + warp * tick, path, 0) == pytest.approx(path, abs=1e-12)


def test_blending_ends_when_the_samples_are_there_again() -> None:
    smoothing = Blend(MS)
    for at_ms in range(10):
        joined(smoothing, at_ms, straight(at_ms), 0)
    assert smoothing.busy
    steps, before = [], 0.09
    for at_ms in range(10, 110):
        if not smoothing.busy:
            break
        path = straight(at_ms, offset=0.1)
        # A frame of 5 samples each 5 ms, all of them on time again.
        felt = joined(smoothing, at_ms, path, 20 + at_ms // 5 * 5)
        steps.append(felt[0] - before)
        before = felt[0]
    assert not smoothing.busy
    assert felt == path
    assert len(steps) > 5
    # It gives way over several ticks: the jump was 0.1 on a slope of 0.01 a tick.
    assert max(steps) < 0.01 + 0.05


@pytest.mark.parametrize("at_ms", [20, 1000, -1000])
def test_over_missed_ticks_and_jumps_nothing_is_joined(at_ms: int) -> None:
    smoothing = Blend(MS)
    for before_ms in range(10):
        joined(smoothing, before_ms, straight(before_ms), 0)
    path = straight(at_ms, offset=1.0)
    assert joined(smoothing, at_ms, path, 5) == path


def test_a_prediction_without_bounds_leaves_nothing_behind() -> None:
    smoothing = Blend(MS)
    joined(smoothing, 40, straight(40), 0)
    joined(smoothing, 41, [math.inf] * 4, 1)
    joined(smoothing, 42, [math.nan] * 4, 2)
    for at_ms in range(43, 60):
        path = straight(at_ms)
        felt = joined(smoothing, at_ms, path, 3)
    assert felt == pytest.approx(path)


def concealment(predictor: PredictorName, auto: bool = True) -> Concealment:
    return Concealment(predictor, 0, MS, auto)


def frame(first: int, values: list[float]) -> Frame:
    """A sample a millisecond."""
    return Frame(1, first, first * MS, MS, np.array(values)[:, np.newaxis])


@pytest.mark.parametrize(
    ("predictor", "auto", "trusted"),
    [("linear", True, None), ("hold", True, None), ("stack", False, None), ("stack", True, False)],
)
def test_only_a_predictor_with_an_error_estimate_can_be_trusted_under_auto(
    predictor: PredictorName, auto: bool, trusted: bool | None
) -> None:
    stand_in = concealment(predictor, auto)
    stand_in.judge(5 * MS, 5 * MS)
    assert stand_in.trusted is trusted


def test_what_was_received_is_left_as_it_is() -> None:
    stand_in = concealment("linear")
    stand_in.observe(frame(0, [0.1, 0.2, 0.3]))
    path_n = [0.1, 0.2]
    assert stand_in.complete(path_n, 2, 0, 2 * MS) is path_n


def test_what_is_missing_is_predicted_and_comes_in_without_a_jump() -> None:
    stand_in = concealment("hold")
    stand_in.observe(frame(0, [0.3, 0.3]))
    assert stand_in.complete([0.3], 3, 1 * MS, 1 * MS) == pytest.approx([0.3] * 3)
    assert stand_in.complete([], 3, 5 * MS, 1 * MS) == pytest.approx([0.3] * 3)
    stand_in.observe(frame(2, [0.5] * 4))
    corrected = stand_in.complete([], 3, 6 * MS, 5 * MS)
    assert corrected[0] == pytest.approx(0.3)
    assert 0.3 < corrected[1] < corrected[2] < 0.5


SECOND_NS = 1_000 * MS
TICK_NS = 5 * MS


def judged(
    trust: Trust, from_s: float, to_s: float, error_n: float | None, size_n: float = 0.3
) -> list[bool]:
    """Return whether it is trusted after each tick."""
    said = []
    for now_ns in range(round(from_s * SECOND_NS), round(to_s * SECOND_NS), TICK_NS):
        trust.judge(now_ns, error_n, size_n)
        said.append(trust.trusted)
    return said


def test_trust_is_won_slowly_and_lost_at_once() -> None:
    trust = Trust()
    assert not any(judged(trust, 0, 15, 0.003))
    assert judged(trust, 15, 20, 0.003)[-1]
    # A prediction that is off by a third of the pulse.
    lost = judged(trust, 20, 20.5, 0.1)
    assert lost.index(False) * TICK_NS <= 50 * MS
    assert not any(lost[lost.index(False) :])
    assert not any(judged(trust, 20.5, 30.5, 0.003))
    assert judged(trust, 30.5, 37, 0.003)[-1]


@pytest.mark.parametrize(
    ("error_n", "size_n"), [*((e, 0.3) for e in (None, 0.0085, math.inf)), (0.0, 0.0)]
)
def test_without_a_pulse_or_a_small_known_error_there_is_no_trust(
    error_n: float | None, size_n: float
) -> None:
    assert not any(judged(Trust(), 0, 60, error_n, size_n))


def test_between_the_two_bounds_nothing_changes() -> None:
    stranger, friend = Trust(), Trust()
    judged(friend, 0, 20, 0.003)
    assert not any(judged(stranger, 20, 60, 0.0105))
    assert all(judged(friend, 20, 60, 0.0105))
    # Further ahead than is predicted, no error is known: a silence counts while it lasts.
    friend.judge(61 * SECOND_NS, None, 0.3)
    assert not friend.trusted


@pytest.mark.parametrize(("stall_ms", "trusted"), [(20, True), (60, False)])
def test_it_matters_for_how_long_an_error_would_be_felt(stall_ms: int, trusted: bool) -> None:
    trust = Trust()
    for now_ms in range(0, 40_000, 5):
        # A tenth of the pulse, twice a second.
        trust.judge(now_ms * MS, 0.03 if now_ms % 500 < stall_ms else 0.0, 0.3)
    assert trust.trusted is trusted


def observe(size: PulseSize, from_s: float, to_s: float, offset_n: float = 0.0) -> None:
    """A sine of 0.3 N from foot to peak, 1.2 times a second."""
    for first_ms in range(round(from_s * 1000), round(to_s * 1000), 5):
        wave = [math.sin(2 * math.pi * 1.2e-3 * (first_ms + ms)) for ms in range(5)]
        size.observe(first_ms * MS, [0.15 * value + offset_n for value in wave])


def test_the_pulses_size_is_known_after_a_window() -> None:
    size = PulseSize()
    observe(size, 0, 2)
    assert size.size is None
    observe(size, 2, 2.1)
    assert size.size == pytest.approx(0.3, rel=1e-3)


def test_a_jump_of_the_hand_does_not_make_the_pulse_larger() -> None:
    size = PulseSize()
    observe(size, 0, 11)
    observe(size, 11, 13, offset_n=2.0)
    observe(size, 13, 20)
    assert size.size == pytest.approx(0.3, rel=1e-3)


def test_a_pulse_that_has_changed_is_measured_anew() -> None:
    size = PulseSize()
    observe(size, 0, 20)
    for first_ms in range(20_000, 40_000, 5):
        size.observe(first_ms * MS, [0.1 * (first_ms % 1000 < 500)])
    assert size.size == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("carried_ms", "trusted", "wanted_ms"),
    [(60, False, 60), (60, True, 0), (0, True, 0), (450, True, 50), (450, False, 450)],
)
def test_trust_takes_off_at_most_what_is_slewed(
    carried_ms: int, trusted: bool, wanted_ms: int
) -> None:
    assert auto_delay_ns(carried_ms * MS, trusted) == wanted_ms * MS
    assert MOST_NS < 500 * MS
